"""Markdown tables of benchmark results.

`TABLES` has the functions for records that need computed figures, such as medians, ratios or megabytes.
`generic` prints all other records as stored.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from statistics import median
from typing import Any

from benchmarks.repair_figures import repair_tables, trial_table

Record = dict[str, Any]


def table(heads: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a Markdown table."""
    lines = [list(heads), *(map(cell, row) for row in rows)]
    text = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([text[0], "|---" * len(lines[0]) + "|", *text[1:]])


def cell(value: Any) -> str:
    """Return the text of a value. Thousands are separated, lists are joined, and None is a dash."""
    if value is None:
        return "--"
    if isinstance(value, dict):
        return ", ".join(f"{label(key)} {cell(part)}" for key, part in value.items())
    if isinstance(value, list):
        return "; ".join(map(cell, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = f"{value:,}" if isinstance(value, int | float) else str(value)
    return text.replace("|", "/").replace("<", "&lt;")


def label(key: str) -> str:
    """Return the words of a JSON key."""
    return key.replace("_", " ")


def number(value: float | None, digits: int) -> str | None:
    """Return a value rounded to this number of decimals. None stays None."""
    return None if value is None else f"{value:,.{digits}f}"


def percent(share: float, digits: int) -> str:
    """Return a share as a percentage."""
    return f"{100 * share:.{digits}f} %"


# ---- records printed as stored


def generic(record: Any) -> Iterator[str]:
    """Yield the tables of a record: a table of the plain values, then a table for each list of rows and each
    part.
    """
    plain = {key: value for key, value in record.items() if not _is_part(value)}
    if "what" in plain:
        yield f"{plain.pop('what')}."
    if plain:
        yield table(["figure", "value"], [(label(key), value) for key, value in plain.items()])
    for key, value in record.items():
        if isinstance(value, list) and _is_part(value):
            heads = list(dict.fromkeys(name for row in value for name in row))
            yield f"### {label(key)[0].upper()}{label(key)[1:]}" if key != "rows" else ""
            yield table(map(label, heads), [[row.get(name) for name in heads] for row in value])
        elif _is_part(value):
            yield f"### {label(key)[0].upper()}{label(key)[1:]}"
            yield from generic(value)


def _is_part(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and any(isinstance(x, dict) for x in value))


# ---- records with computed figures


def audit(record: Record) -> Iterator[str]:
    """Yield a table of peers at every size, then tables of our own measurements."""
    for size in record["sizes"]:
        yield f"### {size['faces']:,} faces"
        yield table(
            ["tool", "seconds", "/ ours", "bytes a face", "what it does"],
            [
                (row["tool"], None, None, None, row["error"])
                if "error" in row
                else (
                    row["tool"],
                    number(row["seconds"], 3),
                    number(row["ratio"], 2),
                    number(row["bytes_per_face"], 0),
                    record["what"][row["tool"]] + "; DIFFERS: " * bool(row["differs"]) + cell(row["differs"]),
                )
                for row in size["rows"]
            ],
        )
    yield "### Ours"
    yield table(
        ["figure", "value"],
        [
            (
                "growth with the number of faces, exponent",
                {k: number(v, 2) for k, v in record["growth"].items()},
            )
        ]
        + [
            (f"{label(part)}, seconds", {key: number(value, 2) for key, value in record[part].items()})
            for part in ("threads", "first", "process")
        ],
    )
    yield "### Hostile meshes"
    yield table(
        ["mesh", "faces", "seconds", "bytes a face", "growth, exponent", "what it is"],
        [
            (
                row["mesh"],
                int(count),
                number(found["seconds"], 3),
                number(found["bytes"] / int(count), 0),
                number(row["growth"], 2),
                row["what"],
            )
            for row in record["hostile"]
            for count, found in row["at"].items()
        ],
    )


def bake(record: Record) -> Iterator[str]:
    """Yield a table of bakes with their PSNR against held-out photographs, and the shape of surfaces.

    The angle to the true normals is in degrees: average, median, share above 30 degrees.
    """
    yield table(
        [
            *("model", "geometry", "native, dB", "before, 1 sample", "baked, 1", "baked, 16", "triangles"),
            *("texture", "MB", "seconds", "peak MB", "verdict", "bending", "normals, degrees"),
        ],
        [
            (
                row["model"],
                row["geometry"],
                *(
                    number(row["psnr"]["photographs"][k], 2)
                    for k in ("native", "before", "after", "after_16")
                ),
                row["faces"],
                row["texture"] and row["texture"][0],
                number(row["bytes"] / 1e6, 2),
                number(row["seconds"], 0),
                row["peak_mb"],
                row["verdict_after"]["level"],
                *_shape(row),
            )
            for row in record["rows"]
        ],
    )


def _shape(row: Record) -> tuple[str | None, str | None]:
    """Return the bending and the angles to the true normals of a bake, None if they were not measured."""
    shape = row.get("shape")
    if shape is None:
        return None, None
    error = shape["normal_error"]
    angles = error and f"{error['mean']:.1f} / {error['median']:.1f} / {100 * error['above_30']:.0f} %"
    return number(shape["bending"], 0), angles


def bake_scale(record: Record) -> Iterator[str]:
    """Yield a table of the bakes of the garden with their PSNR against native rendering, and a table of their
    stages.
    """
    yield table(
        [
            *("faces", "views", "geometry", "variant", "before, 1 sample", "baked, 1", "baked, 16"),
            *("triangles", "seconds", "processor", "peak GB"),
        ],
        [
            (
                row["model_faces"],
                row["of_views"],
                row["geometry"],
                row.get("variant", ""),
                *(number(row["psnr"]["native"][key], 2) for key in ("before", "after", "after_16")),
                row["faces"],
                number(row["seconds"], 0),
                number(row["processor_seconds"], 0),
                number(row["peak"] / 1e9, 2),
            )
            for row in record["rows"]
        ],
    )
    yield "### Stages: seconds, CPU seconds, peak GB"
    stages = list(dict.fromkeys(name for row in record["rows"] for name in row["stages"]))
    yield table(
        ["faces, views, geometry", *stages],
        [
            (
                f"{row['model_faces']:,}, {row['of_views']}, {row['geometry']} {row.get('variant', '')}",
                *(
                    f"{took[0]:.1f}, {took[1]:.1f}, {took[2] / 1e9:.2f}" if took else None
                    for took in map(row["stages"].get, stages)
                ),
            )
            for row in record["rows"]
        ],
    )


def before(record: Record) -> Iterator[str]:
    """Yield a row for each command and frame. The ratio compares seconds, or the times of a frame."""
    yield f"Before is commit {record['before']}; {record['faces']:,} faces; medians, measured in turns."
    rows = []
    for name, pair in record["rows"].items():
        keys = ("frame",) if pair[0][0]["frame"] is not None else ("seconds", "processor", "peak")
        old, new = ({key: median(one[key] for one in rounds) for key in keys} for rounds in pair)
        digits = 1 if "frame" in keys else 2
        texts = [
            [number(side.get(key), digits) for key in ("seconds", "processor", "peak", "frame")]
            for side in (old, new)
        ]
        rows.append([name, *texts[0], *texts[1], number(new[keys[0]] / old[keys[0]], 2)])
    sides = [
        f"{side}{what}" for side in ("before: ", "now: ") for what in ("s", "processor s", "GB", "frame, ms")
    ]
    yield table(["command or frame", *sides, "now / before"], rows)


def dedicated(record: Record) -> Iterator[str]:
    """Yield tables of the stages, and of blending, threads and frames if they were measured."""
    yield f"Device: {record['device']}. Medians of {record['rounds']} rounds, milliseconds."
    stages = list(record["stages"][0]["ms"])
    yield table(
        [
            "method",
            "faces",
            "size",
            "listed",
            "pairs",
            *stages,
            "sum",
            "before blending",
            "project / traffic",
            "textbook / ours",
        ],
        [
            (
                *(row[key] for key in ("method", "faces", "size", "listed", "pairs")),
                *(number(value, 1) for value in row["ms"].values()),
                number(row["sum"], 1),
                percent(row["before blending"], 0),
                number(row.get("project / traffic"), 1),
                number(row.get("textbook / ours"), 2),
            )
            for row in record["stages"]
        ],
    )
    if "blend" in record:
        ways = list(record["blend"][0]["ms"])
        yield "### Blending"
        yield table(
            ["faces", "size", "pairs", *ways, "ours / C"],
            [
                (
                    row["faces"],
                    row["size"],
                    row["pairs"],
                    *(number(row["ms"][way], 1) for way in ways),
                    number(row["ours / C"], 2),
                )
                for row in record["blend"]
            ],
        )
    if "one thread" in record:
        yield "### Time of one thread / time of all"
        same = {(row["method"], row["faces"], row["size"]): row for row in record["stages"]}
        rows = []
        for row in record["one thread"]:
            every = same[row["method"], row["faces"], row["size"]]
            ratios = [number(row["ms"][name] / every["ms"][name], 2) for name in stages]
            rows.append(
                [row["method"], row["faces"], row["size"], *ratios, number(row["sum"] / every["sum"], 2)]
            )
        yield table(["method", "faces", "size", *stages, "sum"], rows)
    if "frames" in record:
        yield from generic({"frames": record["frames"]})


def engines(record: Record) -> Iterator[str]:
    """Yield a table for each scene."""
    for name, rows in record["scenes"].items():
        yield f"### {record['titles'][name]}"
        yield f"{rows[0]['pixels']:,} pixels, {rows[0]['interior']:,} of them interior."
        yield table(
            [
                "renderer",
                "within a level",
                "PSNR, dB",
                "covered alike",
                "interior within a level",
                "99.9 %",
                "max",
            ],
            [
                (
                    f"`{row['engine']}`",
                    percent(row["within_a_level"], 3),
                    number(row["psnr"], 1),
                    percent(row["covered_alike"], 3),
                    percent(row["interior_within_a_level"], 3),
                    number(row["interior_p999"], 0),
                    number(row["interior_max"], 0),
                )
                for row in rows
            ],
        )
    rows = next(iter(record["scenes"].values()))
    yield table(["renderer", "drawn by"], [(f"`{row['engine']}`", row["drawn_by"]) for row in rows])


STAGES = ("project", "sort", "records", "bin", "blend", "resolve")


def engines_dedicated(record: Record) -> Iterator[str]:
    """Yield a table for each scene and method."""
    by: dict[str, str] = {}
    for scene, methods in record["scenes"].items():
        for method, rows in methods.items():
            yield f"### {record['titles'][scene]}: {method}, {len(rows[0]['rounds'])} rounds"
            lines: list[Iterable[Any]] = []
            ours = sum(_stage_times(rows[0]).values())
            for row in rows:
                if "error" in row:
                    lines.append([row["renderer"], *[None] * len(STAGES), row["error"], None, None, None])
                    continue
                by[row["renderer"]] = ", ".join(row["drawn_by"])
                times = _stage_times(row)
                whole = sum(times.values())
                note = " (wall clock)" if times.keys().isdisjoint(STAGES) else ""
                equal = None if row is rows[0] else number(min(row["psnr"]), 1)
                cells = [number(times.get(stage), 1) for stage in STAGES]
                size = number(row["bytes"] / 1e6, 0)
                lines.append(
                    [row["renderer"], *cells, f"{whole:.1f}{note}", number(whole / ours, 2), equal, size]
                )
            yield table(["renderer", *STAGES, "frame, ms", "/ ours", "least dB to ours", "MB"], lines)
    yield table(["renderer", "drawn by"], by.items())


def _stage_times(row: Record) -> dict[str, float]:
    """Return for each stage the median milliseconds per frame over all cameras."""
    frames = [frame for turn in row["rounds"] for frame in turn]
    return {stage: median(frame[stage] for frame in frames) for stage in frames[0]}


def export(record: Record) -> Iterator[str]:
    """Yield a table of medians, with the two ratios to a plain copy."""
    rounds = record["rounds"]
    asset = rounds[0]["export"]["size"]
    yield f"{record['triangles']:,} triangles of SH degree 3, {asset:,} bytes; medians of {len(rounds)}."
    rows = []
    for task in rounds[0]:
        seconds, hashing, peak = (
            median(r[task][key] for r in rounds) for key in ("seconds", "hashing", "peak")
        )
        ratio = median((r[task]["seconds"] - r[task]["hashing"]) / r["copy"]["seconds"] for r in rounds)
        rows.append([task, number(seconds, 2), number(hashing, 2), number(ratio, 2), number(peak / asset, 2)])
    yield table(["task", "seconds", "hashing", "without hashing / copy", "peak / asset"], rows)


def opened(record: Record) -> Iterator[str]:
    """Yield a table for each scene and file: levels of 1/255 in the interior of faces, and dB."""
    heads = ["median", "within 1", "99.9 %", "dB"]
    by: dict[str, str] = {}
    for name, rows in record["scenes"].items():
        yield f"### {record['titles'][name]}"
        lines = []
        for row in rows:
            cells = [_levels(row.get("as_it_comes")), _levels(row.get("mended"))]
            lines.append([row["engine"], *cells[0], *cells[1], row.get("not_run", "")])
            by |= {row["engine"]: row["by"]} if "by" in row else {}
        yield table(["engine", *heads, *(f"set right: {head}" for head in heads), "not run"], lines)
    about = record["differences"]
    yield table(
        ["engine", "version", "difference", "setting that fixes it"],
        [
            (name, text, *(about.get(name, {}).get(key) for key in ("why", "setting")))
            for name, text in by.items()
        ],
    )


def _levels(found: Record | None) -> list[str | None]:
    if found is None:
        return [""] * 4
    return [
        number(found["median"], 0),
        percent(found["within_1"], 1),
        number(found["p999"], 0),
        number(found["db"], 1),
    ]


def primitives(record: Record) -> Iterator[str]:
    """Yield a row for each size and pair."""
    yield f"Device: {record['device']}. Medians."
    yield table(
        ["elements", "work", "ours, ms", "pyopencl, ms", "/ ours", "held, MB: ours, pyopencl"],
        [
            (
                int(count),
                row["name"],
                *(number(row[key], 2) for key in ("ours", "theirs", "ratio")),
                [number(size / 1e6, 0) for size in row.get("held", ())],
            )
            for count, rows in record["sizes"].items()
            for row in rows
        ],
    )


def repair(record: Record) -> Iterator[str]:
    """Yield a row for each size and tool."""
    yield "CPU seconds; the ratio is to the audit's NumPy twin on the same mesh."
    yield table(
        ["faces", "tool", "seconds", "/ twin", "bytes a face", "result"],
        [
            (
                int(count),
                row["tool"],
                number(row["seconds"], 2),
                number(row["ratio"], 2),
                number(row["bytes_per_face"], 0),
                row["rounds"][0]["answers"],
            )
            for count, rows in record["sizes"].items()
            for row in rows
        ],
    )


def scale(record: Record) -> Iterator[str]:
    """Yield a table by method and step. Bytes per face are the growth of the process during the step."""
    rows = []
    for steps in record.get("runs") or [record["steps"]]:
        for method, found in steps.items():
            asset = found["export"]["asset"] / found["export"]["faces"]
            for step, one in found.items():
                head = [method, found["export"]["faces"], number(asset, 0), step]
                if "unsupported" in one:
                    rows.append([*head, "not supported", *[None] * 4])
                    continue
                high, private = one["peak"], one["private"]
                a_face = [(value - one["before"]) / one["faces"] for value in (high, private)]
                memory = [number(value / 1e9, 2) for value in (high, private)]
                rows.append(
                    [*head, number(one["seconds"], 1), *memory, *(number(each, 0) for each in a_face)]
                )
    heads = ["method", "faces", "asset, bytes per face", "step", "seconds", "peak GB", "private GB"]
    yield table([*heads, "peak, bytes per face", "private, bytes per face"], rows)


def sizes(record: Record) -> Iterator[str]:
    """Yield a row for each size and command."""
    rows = []
    for count, commands in record["sizes"].items():
        for command, rounds in commands.items():
            seconds, processor, peak = (
                median(one[key] for one in rounds) for key in ("seconds", "processor", "peak")
            )
            bounds = {kind: percent(share, 0) for kind, share in rounds[0]["bounds"].items() if share >= 0.1}
            rows.append(
                [int(count), command, number(seconds, 1), number(processor, 1), number(peak / 1e9, 2), bounds]
            )
    yield table(["faces", "command", "seconds", "processor", "peak GB", "bound by"], rows)
    if "comparisons" in record:
        yield from generic({"comparisons": record["comparisons"]})


def standard(record: Record) -> Iterator[str]:
    """Yield a table for each scene."""
    yield "1237 x 822 pixels; medians. First: seconds to the first frame. Equal: within a level of ours."
    for scene in record["scenes"]:
        yield f"### {scene['scene']}: {scene['what']}"
        lines = []
        for row in scene["rows"]:
            if "error" in row:
                lines.append([row["tool"], *[None] * 6, f"{row['what']}; not run: {row['error'][:120]}"])
                continue
            equal = percent(row["within_a_level"], 2) if "within_a_level" in row else None
            ready, times = (
                row["prepared"],
                (number(row["ms"], 1), number(row.get("ratio"), 2), number(row["cpu_ms"], 1)),
            )
            lines.append(
                [
                    row["tool"],
                    *times,
                    number(ready["seconds"], 2),
                    number(ready["bytes"] / 1e6, 0),
                    equal,
                    row["what"],
                ]
            )
        yield table(["tool", "ms", "/ ours", "CPU ms", "first", "MB", "equal", "what it is"], lines)


def figures(record: Record) -> Iterator[str]:
    """Trials and repairs of single meshes, measured by tools/figures/repair.py."""
    yield "### Trials"
    yield trial_table(record).strip()
    yield "### Repairs compared"
    yield repair_tables(record).strip()


TABLES: dict[str, Callable[[Record], Iterator[str]]] = {
    "audit-2-cores": audit,
    "bake-2-cores": bake,
    "bake-scale-2-cores": bake_scale,
    "bake-scale-h200": bake_scale,
    "before-2-cores": before,
    "dedicated-2-cores": dedicated,
    "dedicated-h200": dedicated,
    "engines-2-cores": engines,
    "engines-dedicated-2-cores": engines_dedicated,
    "export-2-cores": export,
    "opened-in-2-cores": opened,
    "primitives-2-cores": primitives,
    "primitives-h200": primitives,
    "repair-2-cores": repair,
    "repair-figures": figures,
    "scale-2-cores": scale,
    "sizes-2-cores": sizes,
    "standard-2-cores": standard,
    "standard-textured-2-cores": standard,
    "weigh-2-cores": scale,
}
"""For each result name, the function that yields its tables."""
