"""A pose database from images that were searched for: "woman sit chair" [paper 3.2]."""
