"""The columns of a run's tables, and the keys of its summary: names, types, units and meanings."""

from __future__ import annotations

from typing import NamedTuple


class Column(NamedTuple):
    """A column of a parquet file: name, Arrow type and meaning."""

    name: str
    type: str
    meaning: str


STEPS = (
    Column("step", "int32", "the step, from 1; one step is one second, or `step_s` seconds"),
    Column("robot", "int32", "the robot's number, from 0; killed and lost robots have no row"),
    Column("x", "double", "meters to the right, in the map's frame"),
    Column("y", "double", "meters upwards, in the map's frame"),
    Column("heading", "double", "degrees; 0 points along x, 90 along -y"),
    Column("driven", "double", "meters driven since the start"),
    Column(
        "team_seen",
        "double",
        "share of the reachable cells that the team has seen, 0 to 1; in the field, of the free cells of its final map",
    ),
    Column("target_x", "double", "meters, as x, of the target cell; null: no target"),
    Column("target_y", "double", "meters, as y"),
    Column("known_cells", "int32", "number of known cells on the robot's own map"),
    Column("backlog", "int32", "log entries that teammates lack, summed over teammates"),
    Column("status", "string", "the robot's activity"),
    Column("work_us", "int32", "processor time of the robot in this step, in microseconds"),
)
"""One row per step and robot (``steps.parquet``)."""

LEDGER = (
    Column("step", "int32", "the step, from 1"),
    Column("round", "int16", "the round within the step, from 0"),
    Column("connection", "int32", "the connection within the step, in processing order; -1: none"),
    Column("frame", "int16", "0 offer, 1 answer, 2 data, 3 broadcast, 4 news"),
    Column("sender", "int16", "the sending robot"),
    Column("receiver", "int16", "the addressed robot; -1: broadcast"),
    Column("map", "int16", "the map that the connection transfers; -1: none"),
    Column("kind", "string", "packet type: ins, rep, ..., scan, pose; malformed"),
    Column("packets", "int32", "number of packets"),
    Column("bytes", "int32", "bytes of these packets"),
    Column("carried", "bool", "whether they were transmitted"),
    Column("cause", "string", "why they were not transmitted, or not received; empty if they were"),
    Column("received_by", "int16", "number of robots that received them"),
)
"""One row per frame and packet type in it (``ledger.parquet``)."""

MAP_CHANGES = (
    Column("robot", "int16", "the robot whose maps changed"),
    Column("step", "int32", "the step at whose end the cell had this value; reported every five steps"),
    Column("x", "int16", "the cell's column"),
    Column("y", "int16", "the cell's row, from the top"),
    Column("own", "uint8", "the cell on the robot's own map: 0 unknown, 1 free, 2 occupied"),
    Column("planning", "uint8", "the cell on its planning map, which includes its teammates' maps"),
)
"""One row per changed cell (``map_changes.parquet``)."""

OUTLINES = (
    Column("robot", "int16", "the robot that holds the outlines"),
    Column("step", "int32", "the step at whose end they had changed"),
    Column("map", "int16", "the robot whose map they describe"),
    Column("vertices", "binary", "int16 rows of four (`protocol.messages.Outlines`)"),
)
"""One row per changed set of outlines (``outlines.parquet``); only for the polygon encoding."""

MISSED = (
    Column("step", "int32", "the step, from 1"),
    Column("phase", "string", "step: took no part in it; move: moved too late; else the phase of the medium"),
    Column("round", "int16", "the round of the medium, from 0"),
    Column("robot", "int16", "the robot that missed it"),
)
"""One row per robot and phase of a step that it missed (``missed.parquet``); only for runs by the wall clock."""

SUMMARY = {
    "finished": "whether a robot finished, and the team has seen at least `min_coverage`",
    "reason": "why the run ended; `robot R stopped too early` if the team has seen less",
    "steps": "exploration time",
    "explored_at": "the same without the steps in which robots confirm that nothing is left; null if not finished",
    "known_at": "step at which the first robot knew the full map: its planning grid had 99.9 % of the reachable cells "
    "as free or occupied, and the team had seen as many; at the latest `explored_at`. Null on the Zenoh bus",
    "first_robot": "the robot that finished first; on a tie, the lowest number",
    "coverage": "share of the truly reachable free cells that the team has seen, as the world has recorded",
    "map_accuracy": "share of those that the first robot's planning grid has right, at most `coverage`",
    "mean_map_accuracy, worst_map_accuracy": "mean and minimum over all robots that have sent their maps",
    "claimed_map_accuracy, claimed_mean_map_accuracy, claimed_worst_map_accuracy": "the same, as robots claim. Keys "
    "`claimed_...` have no other source than robots",
    "claimed_wall_precision, claimed_wall_recall": "share of its walls that lie within one cell of a true one, and of "
    "true walls beside reachable cells that have one of its walls within one cell",
    "claimed_wall_f1": "the harmonic mean of both",
    "claimed_mean_wall_precision, claimed_mean_wall_recall, claimed_mean_wall_f1": "mean over all robots",
    "claimed_worst_wall_precision, claimed_worst_wall_recall, claimed_worst_wall_f1": "minimum over all robots, each "
    "on its own",
    "walls_within_tolerance, worst_walls_within_tolerance": "share of the walls of which a robot is certain that a "
    "teammate's shared map has within `tolerance`, at the end: mean and minimum over all pairs; null for one robot. "
    "Agreement, not truth: it compares robots' claims with each other",
    "robot_maps": "for each robot: `map_accuracy`, `wall_precision`, `wall_recall`, `wall_f1`, and of its teammates' "
    "walls `walls_within_tolerance` and `worst_walls_within_tolerance`",
    "refuted_maps": "robots whose own map is false beyond noise, or too large; other keys leave them out",
    "t50, t90, t95, t99": "steps at which the team had seen 50, 90, 95, and 99 %",
    "longest_path, longest_path_95, longest_path_99": "meters of the robot that had driven farthest: at the end, at "
    "`t95`, at `t99`",
    "overlap": "cells seen by more than one robot over cells seen; null if a robot was lost with its grid",
    "overlap_sum": "cells seen by each robot, summed, over cells seen by the team, minus 1 (overlap of Explore-Bench)",
    "seen_std": "standard deviation over robots of the share of the reachable cells that each has seen itself",
    "path_length": "meters, one value per robot",
    "robots, seed, map, bus, strategy, map_encoding, bandwidth, range_m": "settings",
    "finish": "robots that had to finish: `first`, or `all`, as in missions that return and recorded runs",
    "clock, step_s": "settings",
    "missed_steps, missed_steps_by_robot": "by the wall clock: steps in which robots did not move in time, in total "
    "and one value per robot; 0 with the barrier; in the field: steps that took a robot too long",
    "missed_phases": "by the wall clock: phases of the medium that robots did not answer in time; 0 with the barrier",
    "tolerance": "cells by which walls on maps of different robots may differ: the setting `tolerance`, and at least 1 "
    "if lasers or poses have errors",
    "bytes, packets": "transmitted, by kind of packet",
    "raw_scan_bytes": "raw scans by the thesis' formula (section 6.3): steps x 362 values of 2 bytes x r(r - 1)",
    "map_code_bytes": "an adaptive context code of the first robot's planning grid (`deploy.record.map_code`): "
    "about the fewest bytes that describe the building",
    "map_code_multiple": "transmitted bytes over `map_code_bytes`",
    "approximation_error": "Eq. 6.1, of the first robot: mean over its steps, as a share of the cells to explore; null "
    "for map encodings that do not approximate",
    "approximation_error_net": "the same minus that of an exact approximation; null without `polygons.exact_error`",
    "over_budget_steps": "steps that exceeded the budget: 0",
    "duty_cycle": "largest share of an hour in which a robot sent, by its bytes and the bandwidth; null without a "
    "limited bandwidth",
    "undelivered": "frames not delivered, by cause",
    "lost, protocol_errors": "robots that died unexpectedly; number of protocol errors",
    "reconnected": "step and robot of each connection that was cut and restored",
    "returned": "step and robot of each restart after an unexpected death",
    "digest, versions": "hash of all results; versions of the code and its libraries, which equal digests require",
    "tables": "SHA-256 of each parquet file, of scenario and map, and of the scans that a recorded run has replayed",
    "wall_s, steps_per_s, work_us_median": "performance; not part of the result",
}
"""Keys of ``summary.json`` and their meaning."""

RECORDED = {
    "logs": "the logs that were replayed",
    "scans": "number of scans that the robots have taken from them",
    "bytes_per_scan": "bytes that the whole team transmitted, over `scans`",
    "steps_after_scans": "steps from the last scan until teammates held everything, or to the end if they did not",
    "backlog_after_scans, backlog": "log entries that teammates lacked, after the last scan and at the end",
}
"""Keys of ``summary.json`` that only recorded runs have."""

FIELD = {
    "team_map_held, worst_team_map_held": "share of the free cells of the team's map that are free on a robot's "
    "planning map: mean and minimum over all robots; also by robot, in `robot_maps`",
    "frames, frames_lost": "sealed frames of the radio, and those that no robot recorded as received",
    "clock_error_s": "bound of the error of the robots' aligned clocks, with their drift, seconds; null: unknown",
    "isolated_robots": "robots that exchanged no frame with another one, as far as their records show it",
}
"""Keys of ``summary.json`` that only robots in the field have; keys that need a true map are null there."""

FILES = {
    "steps.parquet": STEPS,
    "ledger.parquet": LEDGER,
    "map_changes.parquet": MAP_CHANGES,
    "outlines.parquet": OUTLINES,
    "missed.parquet": MISSED,
}
