"""How well the pose database tells actions apart (Section 3.2): table, confusions, pictures."""

from pathlib import Path

from chunk_job import logged

from hoi.actions.config import ActionsConfig
from hoi.actions.database import load_database
from hoi.actions.leave_one_out import accuracy_report, confusion_table, examples
from hoi.actions.queries import queries, write_queries
from hoi.actions.space import load_action_space
from hoi.body.files import read_body_file
from hoi.body.upright import stand
from hoi.report.actions import PoseRow, Tile, actions_page, pose_sheet
from hoi.report.config import ReportConfig

config = ActionsConfig(**snakemake.params.identity["settings"])
report = ReportConfig(**snakemake.params.report)
database = load_database(snakemake.input.pose_database)
space = load_action_space(snakemake.input.action_space, config.min_conceptnet_weight)
body = read_body_file(snakemake.input.body_model)


def default_action(category):
    return space.default_action(category, among=database.actions_of(category))


def tile(row, caption):
    up = None if database.pelvis_up is None else database.pelvis_up[row]
    vertices = stand(body, database.body_pose[row], up)
    return Tile(vertices, str(database.actions[row]), caption)


def pose_row(example):
    found = zip(example.found, example.distances, strict=True)
    answers = (tile(row, f"{distance:.2f}") for row, distance in found)
    return PoseRow((tile(example.row, "left out"), *answers))


with logged(snakemake):
    table = accuracy_report(database, config, default_action)
    confusion = confusion_table(database, table["category"].tolist(), config)
    table.to_csv(snakemake.output.csv, index=False, float_format="%.4f")
    confusion.to_csv(snakemake.output.confusion, index=False)
    known = {(c, a) for c in database.all_categories() for a in database.actions_of(c)}
    nouns = sorted({edge.category for edge in space.edges})
    write_queries(space, nouns, known, Path(snakemake.output.queries))
    sheets = {
        category: pose_sheet(
            [pose_row(e) for e in examples(database, category, config)], body.faces
        )
        for category in table["category"]
    }
    phrases = {name: [str(query) for query in queries(space, name)] for name in sheets}
    page = actions_page(table, confusion, sheets, phrases, report)
    Path(snakemake.output.html).write_text(page)
