"""The localiser's bench as Markdown: the goals first, then the tables behind them."""

from __future__ import annotations

from typing import Any

from target_pose.covariance import BEARING_SIGMA_RAD
from target_pose.fusion import SIZE_SIGMA
from tests.perf.bench_localiser_goals import GOALS, goals
from tests.perf.bench_localiser_poses import BLUR_PX, LOW_LIGHT, TILT_DEG

_ABOUT = """
Rendered scenes with the colour intrinsics of a D455 at 640x480 (f = 385 px; JPEG of quality 50 to
97) and its depth noise (2.5 mm z^2, correlated, 10 to 45 % holes, shadows, a scale 0.2 to 0.5 %
off); tilts uniform from {tilt[0]:g} to {tilt[1]:g} degrees; worn and clean prints, shadows, gloss,
look-alikes beside them. *Nominal* is sharp and fairly lit, *blur* has a point spread of {blur:g} px
(sigma), *low light* {low:g} of the light. Boxes come from the detector and the nesting check, never
from the truth; gravity is 2 degrees off about each axis. In brackets: 95 % confidence intervals, of
medians from order statistics, of shares Wilson's.
"""
_FROM = """
Detector: {name} (SHA-256 {model}), {backend}, {precision}. Localiser: sources {localiser}.
Pictures: seed {seed}, generator {generator}, {backgrounds} backgrounds of the test split. Poses a
cell: {accuracy}, beside the markers {markers}, a case of occlusion {occlusion}, without depth or
picture {ladder}.
"""
_COVARIANCE = """
Share [%] of squared errors over the covariance inside chi-square's 50 / 95 / 99 % (3 degrees of
freedom for the position, 2 for the normal, 5 for both with their correlation, 1 for the roll where
it came from edges or gravity). Less than nominal: too sure of itself. The covariance holds what
calibration and print may be off; so the camera given is off, drawn anew for each pose: focal length
over print size by {size:g} %, the line of sight by {bearing:g} mrad (sigma). The last row is with
the true camera and print, as in all other tables.
"""
_BESIDE = """
The same poses, light, wear and camera, another print on the same board of 0.400 m, as large as its
white margin of one module lets it be: AprilTag's black square is 0.320 m, ArUco's 0.300 m, our
black disc 0.300 m. AprilTag: pupil-apriltags at full resolution; of its own pose and IPPE on its
corners the better one, chosen for each figure. ArUco: OpenCV, corners refined to sub-pixels, IPPE
for squares. `pnp` works on our print and in our boxes. Found: there is a pose. The pairs are
medians over the poses in which both have one: ours / theirs, bold where theirs is smaller.
"""
_TIME = """
By turns on each of {count} poses of the cells above, one process pinned to one core, from the RGB
picture to the pose. `localise` starts from the detector's boxes; the markers' libraries look at
their own print in the same pose, over the whole picture. The ratio is the processor's time of
`localise` over the other's on the same pose: median (quartiles).
"""


def _flow(text: str, **values: Any) -> str:
    """A paragraph on one line."""
    return " ".join(text.format(**values).split())


def report_text(result: dict[str, Any]) -> str:
    """All parts that were measured."""
    detector = result["detector"]
    origin = {key: result[key] for key in ("localiser", "seed", "generator", "backgrounds")}
    running = {key: detector[key] for key in ("name", "backend", "precision")}
    model = detector["model_hash"][:16]
    lines = [
        "# How well the target is localised",
        "",
        f"Made by `{result['command']}` on {result['machine']}.",
        "",
        _flow(_ABOUT, tilt=TILT_DEG, blur=BLUR_PX, low=LOW_LIGHT),
        "",
        _flow(_FROM, model=model, **origin, **running, **result["counts"]),
        "",
        "## Goals",
        "",
        "| | goal | measured | |",
        "| --- | --- | --- | --- |",
    ]
    lines += [f"| {a} | {b} | {c} | {d} |" for a, b, c, d in goals(result)]
    for part, text in (
        ("accuracy", _accuracy),
        ("side_by_side", _side_by_side),
        ("occlusion", _occlusion),
        ("ladder", _ladder),
        ("flips", _flips),
        ("real", _real),
        ("speed", _speed),
    ):
        if result.get(part):
            lines += text(result[part])
    return "\n".join(lines) + "\n"


def share(x: dict[str, float] | None) -> str:
    """In per cent with its interval; a dash where there is none."""
    if x is None:
        return "-"
    return f"{100 * x['value']:.1f} [{100 * x['low']:.1f}, {100 * x['high']:.1f}]"


def median(x: dict[str, float] | None, goal: float | None = None) -> str:
    """With its interval, in bold where it misses its goal."""
    if x is None:
        return "-"
    text = f"{number(x['median'])} [{number(x['low'])}, {number(x['high'])}]"
    return f"**{text}**" if goal is not None and x["median"] > goal else text


def number(value: float) -> str:
    """Two digits after the point under 10, then fewer."""
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 100 else f"{value:.0f}"


def _tail(x: dict[str, float] | None) -> str:
    if x is None:
        return "- | -"
    ratio = x["p95"] / x["median"] if x["median"] > 0 else float("inf")
    return f"{number(x['p95'])} | {ratio:.1f}"


def _goal(goal: float | None) -> str:
    return "" if goal is None else f"{goal:g}"


def _kinds(kinds: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in kinds.items()) or "-"


_HEAD = (
    "| | m | poses | found [%] | refused [%] | ambiguous [%] | position [mm] | goal | p95 | x | "
    "normal [deg] | goal | p95 | x | by |"
)
_RULE = (
    "| --- | ---: | ---: | --- | --- | --- | --- | ---: | ---: | ---: | --- | ---: | ---: | ---: "
    "| --- |"
)


def _cells(cells: list[dict[str, Any]]) -> list[str]:
    lines = [_HEAD, _RULE]
    for c in cells:
        goal: tuple[float | None, float | None] = (None, None)
        if c["condition"] in GOALS and c["distance_m"] is not None:
            goal = GOALS[c["condition"]][c["distance_m"]]
        distance = "" if c["distance_m"] is None else f"{c['distance_m']:g}"
        refused = share(c["refused"])
        if c["reasons"]:
            refused += f" ({_kinds(c['reasons'])})"
        row = [
            c["condition"], distance, str(c["poses"]), share(c["found"]), refused,
            share(c["ambiguous"]), median(c["position_mm"], goal[0]), _goal(goal[0]),
            _tail(c["position_mm"]), median(c["normal_deg"], goal[1]), _goal(goal[1]),
            _tail(c["normal_deg"]), _kinds(c["methods"]),
        ]  # fmt: skip
        lines.append("| " + " | ".join(row) + " |")
    return lines


def _accuracy(part: dict[str, Any]) -> list[str]:
    lines = [
        "",
        "## Position and normal",
        "",
        "Medians of what was localised; bold where over the goal. *x* is p95 over the median.",
        "",
        *_cells(part["cells"]),
        "",
        "## Is the covariance honest?",
        "",
        _flow(_COVARIANCE, size=100 * SIZE_SIGMA, bearing=1e3 * BEARING_SIGMA_RAD),
        "",
        "| | poses | position | normal | both | rolls | roll |",
        "| --- | ---: | --- | --- | --- | ---: | --- |",
    ]
    for name, row in part["calibration"].items():
        cells = [_inside(row[p]["inside"]) for p in ("position", "normal", "pose")]
        numbers = f"{row['roll']['count']} | {_inside(row['roll']['inside'])}"
        lines.append(f"| {name} | {row['position']['count']} | {' | '.join(cells)} | {numbers} |")
    return lines


def _inside(shares: dict[str, Any]) -> str:
    return " / ".join("-" if s is None else f"{100 * s['value']:.1f}" for s in shares.values())


def _side_by_side(rows: list[dict[str, Any]]) -> list[str]:
    others = [name for name in ("apriltag", "aruco", "pnp") if name in rows[0]]
    titles = {"apriltag": "AprilTag", "aruco": "ArUco", "pnp": "the paper's `pnp`"}
    lines = [
        "",
        "## Beside AprilTag 36h11, ArUco 4x4 and the paper's PnP",
        "",
        _flow(_BESIDE),
        "",
        "| | m | poses | found: ours "
        + "".join(f"| {titles[o]} " for o in others)
        + "".join(f"| {titles[o]}: both | position [mm] | normal [deg] " for o in others)
        + "|",
        "| --- | ---: | ---: |"
        + " ---: |" * (1 + len(others))
        + " ---: | ---: | ---: |" * len(others),
    ]
    for r in rows:
        cells = [r["condition"], f"{r['distance_m']:g}", str(r["poses"])]
        cells += [f"{100 * r['found'][name]:.0f} %" for name in ("ours", *others)]
        for name in others:
            pair = r[name]
            cells += [str(pair["both"]), _pair(pair["position_mm"]), _pair(pair["normal_deg"])]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _pair(pair: dict[str, Any]) -> str:
    if pair["ours"] is None or pair["theirs"] is None:
        return "-"
    ours, theirs = pair["ours"]["median"], pair["theirs"]["median"]
    text = f"{number(ours)} / {number(theirs)}"
    return f"**{text}**" if theirs < ours else text


def _occlusion(part: dict[str, Any]) -> list[str]:
    lines = [
        "",
        "## Occluded, cut, mirrored, scratched",
        "",
        "Each pose is to be refused, or its error of position and normal to lie within the 99.9 % "
        f"of its covariance: {len(part['uncovered'])} of {part['localised']} poses do neither.",
        "",
        *_cells(part["cells"]),
    ]
    if part["uncovered"]:
        lines += [
            "",
            "| worst first | seed | by | mm | deg | squared error: position | normal | both |",
            "| --- | --- | --- | ---: | ---: | ---: | ---: | ---: |",
        ]
        for t in part["uncovered"][:20]:
            squared = " | ".join(f"{t['squared'][p]:.1f}" for p in ("position", "normal", "pose"))
            numbers = f"{t['position_mm']:.1f} | {t['normal_deg']:.2f} | {squared}"
            lines.append(f"| {t['cell']} | {tuple(t['seed'])} | {t['method']} | {numbers} |")
    return lines


def _ladder(part: dict[str, Any]) -> list[str]:
    return [
        "",
        "## Without depth, and without a picture",
        "",
        "The nominal poses with no depth at all, and with a black picture in which only the boxes "
        "of the lit one are known.",
        "",
        *_cells(part["cells"]),
    ]


def _flips(part: dict[str, Any]) -> list[str]:
    if not part["count"]:
        return []
    lines = [
        "",
        "## Flipped normals",
        "",
        f"{part['count']} of {part['poses']} localised poses; worst first.",
        "",
        "| | seed | by | tilt [deg] | normal [deg] | position [mm] |",
        "| --- | --- | --- | ---: | ---: | ---: |",
    ]
    for t in part["worst"]:
        numbers = f"{t['tilt_deg']:.0f} | {t['normal_deg']:.1f} | {t['position_mm']:.0f}"
        name = (
            t["cell"] if t["cell"].startswith(t["condition"]) else f"{t['condition']}, {t['cell']}"
        )
        lines.append(f"| {name} | {tuple(t['seed'])} | {t['method']} | {numbers} |")
    return lines


def _real(part: dict[str, Any]) -> list[str]:
    lines = [
        "",
        "## A real recording",
        "",
        "`kitchen-bullseye`, the frames that show at least 90 % of the target, against its own "
        "truth (good to about 3 mm and 1 degree); no gravity given.",
        "",
        "| | frames | found [%] | refused [%] | position [mm] | p95 | normal [deg] | p95 | by |",
        "| --- | ---: | --- | --- | --- | ---: | --- | ---: | --- |",
    ]
    for name, c in part.items():
        p95 = ["-" if c[f] is None else number(c[f]["p95"]) for f in ("position_mm", "normal_deg")]
        lines.append(
            f"| {name} | {c['poses']} | {share(c['found'])} | {share(c['refused'])} | "
            f"{median(c['position_mm'])} | {p95[0]} | {median(c['normal_deg'])} | {p95[1]} | "
            f"{_kinds(c['methods'])} |"
        )
    return lines


def _speed(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "",
        "## Time",
        "",
        _flow(_TIME, count=rows[0]["count"]),
        "",
        "| | p50 [ms] | p99 [ms] | processor, p50 [ms] | localise over it |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for r in rows:
        ratio = f"{r['ratio']:.2f} ({r['ratio_low']:.2f}-{r['ratio_high']:.2f})"
        times = " | ".join(f"{r[k]:.2f}" for k in ("p50_ms", "p99_ms", "cpu_p50_ms"))
        lines.append(f"| {r['name']} | {times} | {ratio} |")
    return lines
