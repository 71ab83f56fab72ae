"""Results of other systems as inputs: masks, keypoints, bodies and contacts from their files.

One module a kind. Each reads files of several formats into plain arrays; `attach` lays them into
the frame, where the stages find them as they find what a data set gives. docs/other_systems.md
"""
