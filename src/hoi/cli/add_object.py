"""``hoi add-object``: a mesh of one's own becomes an object that photos can show."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from hoi.errors import ConfigError

_EPILOG = """\
examples:
  hoi add-object my_stroller.glb --category stroller --contact push:handle:hands
  hoi add-object scan.stl --category trolley --up z --front=-y --unit mm --size 1.0 \\
      --region 'handle: y>0.9' --contact push:handle:hands --contact pull:handle:"one hand"
  hoi add-object seat.obj --category armchair --like chair --part Zitting=chair_seat
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The mesh, and whatever the user wants to say instead of having it guessed."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument("mesh", type=Path, help="a .obj, .glb, .gltf, .ply, .stl or .off file")
    parser.add_argument("--category", required=True, help="what people call it: stroller")
    parser.add_argument("--name", help="of this mesh among others of its category [the file's]")
    shape = parser.add_argument_group("the mesh")
    shape.add_argument("--up", metavar="AXIS", help="the file's axis that points up: y, z, -x ...")
    shape.add_argument("--front", metavar="AXIS", help="the axis that points to its front")
    shape.add_argument("--unit", help="of the file: m, cm, mm, in, ft [the plausible one]")
    shape.add_argument("--vertices", type=int, default=1000, help="of the prepared mesh [1000]")
    parts = parser.add_argument_group("its parts: named groups of the file by default")
    parts.add_argument("--part", action="append", default=[], metavar="GROUP=PART",
                       help="a group of the file is this part")  # fmt: skip
    parts.add_argument("--region", action="append", default=[], metavar="'PART: y>0.8, z<0.3'",
                       help="what lies there is this part; bounds are shares of the box around "
                       "the object: x to its left, y up, z to the front")  # fmt: skip
    parts.add_argument("--labels", type=Path, help="text file: the part of each triangle, a line")
    known = parser.add_argument_group("what is known of it")
    known.add_argument("--size", type=float, metavar="METRES", help="[the mesh's own]")
    known.add_argument("--size-axis", choices=("longest", "height"), default="longest",
                       help="what --size measures")  # fmt: skip
    known.add_argument("--contact", action="append", default=[], metavar="ACTION:PART:BODY",
                       help="who touches what when: push:handle:hands; 'hands' are both, 'hand' "
                       "is either. The first action is the default one")  # fmt: skip
    known.add_argument("--ask", action="append", default=[], metavar="ACTION",
                       help="ask the language model of priors.llm (or its recordings) who touches "
                       "what then, and the size if it is not given")  # fmt: skip
    known.add_argument("--pose", action="append", default=[], metavar="ACTION=ACTION OBJECT",
                       help="what it looks like: 'push=move table'")  # fmt: skip
    known.add_argument("--on-floor", action="append", default=[], metavar="ACTION",
                       help="it stands on the floor meanwhile")  # fmt: skip
    known.add_argument("--off-floor", action="append", default=[], metavar="ACTION",
                       help="it does not")  # fmt: skip
    known.add_argument("--like", metavar="CATEGORY", help="contacts and poses of a known category")
    known.add_argument("--detector-label", action="append", default=[], metavar="CLASS",
                       help="a class of the detector that stands for it")  # fmt: skip
    parser.add_argument("--config", type=Path, default=Path("config/config.yaml"),
                        help="names the folder and the pose database")  # fmt: skip
    parser.add_argument("--folder", type=Path, help="of own objects [assets.own_objects]")
    parser.add_argument("--yes", action="store_true", help="ask nothing; accept what was guessed")


def run(arguments: argparse.Namespace) -> int:
    """Prepare the object and say where it is; 1 when something is missing or not accepted."""
    from hoi.config import load_config
    from hoi.own_objects.adding import Wishes, add_object

    config = load_config(arguments.config)
    asks = sys.stdin.isatty() and sys.stdout.isatty() and not arguments.yes
    wishes = Wishes(
        mesh=arguments.mesh,
        category=arguments.category,
        name=arguments.name or arguments.mesh.stem,
        up=arguments.up,
        front=arguments.front,
        unit=arguments.unit,
        vertices=arguments.vertices,
        groups=_pairs(arguments.part, "--part"),
        regions=tuple(arguments.region),
        labels=arguments.labels,
        size_m=arguments.size,
        size_axis=arguments.size_axis,
        contacts=tuple(arguments.contact),
        poses=_lists(arguments.pose, "--pose"),
        floor={name: True for name in arguments.on_floor}
        | {name: False for name in arguments.off_floor},
        like=arguments.like,
        detector_labels=tuple(arguments.detector_label),
        asked=tuple(arguments.ask),
    )
    folder = arguments.folder or Path(config.assets.own_objects)
    added = add_object(wishes, folder, config, ask=_asker() if asks else None)
    print(added.report)
    return 0 if added.accepted else 1


def _asker() -> Callable[[str], str]:
    """Questions at the terminal; the end of input is an empty answer."""

    def ask(question: str) -> str:
        try:
            return input(question).strip()
        except EOFError:
            return ""

    return ask


def _pairs(texts: list[str], flag: str) -> dict[str, str]:
    """``A=B`` arguments as a mapping."""
    found = {}
    for text in texts:
        left, _, right = text.partition("=")
        if not left.strip() or not right.strip():
            raise ConfigError(f"{flag} {text!r}: write it as NAME=OTHER")
        found[left.strip()] = right.strip()
    return found


def _lists(texts: list[str], flag: str) -> dict[str, tuple[str, ...]]:
    """The same where one name may come several times."""
    found: dict[str, tuple[str, ...]] = {}
    for text in texts:
        ((left, right),) = _pairs([text], flag).items()
        found[left] = (*found.get(left, ()), right)
    return found
