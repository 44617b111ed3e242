"""Draws the three figures of docs/architecture.md as SVG. Run: python docs/figures/draw_architecture.py

The script needs no library. The figures bring their own background for light and for dark pages. Their colours are
those of Okabe and Ito, which people with a colour-vision deficiency can tell apart. Colour alone never carries meaning.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

FOLDER = Path(__file__).resolve().parent

STYLE = """
text { font: 14px "DejaVu Sans", "Segoe UI", Helvetica, Arial, sans-serif; fill: #1b1b1b; text-anchor: middle }
.small { font-size: 12px }
.bold { font-weight: 600 }
.left { text-anchor: start }
.page { fill: #ffffff }
.line { stroke: #3c3c3c; stroke-width: 1.6; fill: none }
.head { fill: #3c3c3c }
.box { stroke-width: 1.8; rx: 6 }
.plant { fill: #fdf0d5; stroke: #b36b00 }
.control { fill: #dcecf7; stroke: #0072b2 }
.slow { fill: #d8f1e8; stroke: #00795a }
.stop { fill: #fbe3d6; stroke: #c04f00; stroke-dasharray: 6 3 }
.file { fill: #f3f3f3; stroke: #6b6b6b }
@media (prefers-color-scheme: dark) {
  text { fill: #ececec }
  .page { fill: #1e2129 }
  .line { stroke: #c9c9c9 }
  .head { fill: #c9c9c9 }
  .plant { fill: #4a3711; stroke: #e69f00 }
  .control { fill: #123b55; stroke: #56b4e9 }
  .slow { fill: #0f4334; stroke: #2fc49a }
  .stop { fill: #55290f; stroke: #f08a4b }
  .file { fill: #343841; stroke: #a5a5a5 }
}
"""


class Drawing:
    """An SVG in the making: boxes, lines with arrow heads, and words."""

    def __init__(self, width: int, height: int, title: str, says: str) -> None:
        self.parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
            'role="img" aria-labelledby="title desc">',
            f'<title id="title">{escape(title)}</title>',
            f'<desc id="desc">{escape(says)}</desc>',
            f"<style>{STYLE}</style>",
            f'<rect class="page" width="{width}" height="{height}" rx="8"/>',
        ]

    def text(self, x: float, y: float, words: str, kind: str = "") -> None:
        """Words at a point of the base line."""
        self.parts.append(f'<text class="{kind}" x="{x:g}" y="{y:g}">{escape(words)}</text>')

    def box(self, x: float, y: float, w: float, h: float, kind: str, lines: Sequence[str]) -> None:
        """A box with its upper left corner at (x, y). The first line of its words is bold."""
        self.parts.append(f'<rect class="box {kind}" x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}"/>')
        first = y + h / 2 - 9 * (len(lines) - 1) + 5.5
        for k, line in enumerate(lines):
            self.text(x + w / 2, first + 18 * k, line, "bold" if k == 0 else "small")

    def arrow(self, *points: tuple[float, float], words: str = "", at: tuple[float, float] | None = None) -> None:
        """A line through points with a head at its end; words at a point of their own."""
        self.line(*points)
        (x1, y1), (x2, y2) = points[-2:]
        length = max(abs(x2 - x1) + abs(y2 - y1), 1e-9)
        ux, uy = (x2 - x1) / length, (y2 - y1) / length
        corners = [(x2, y2), (x2 - 9 * ux - 4.5 * uy, y2 - 9 * uy + 4.5 * ux)]
        corners.append((x2 - 9 * ux + 4.5 * uy, y2 - 9 * uy - 4.5 * ux))
        self.parts.append(f'<polygon class="head" points="{" ".join(f"{x:g},{y:g}" for x, y in corners)}"/>')
        if words and at is not None:
            self.text(*at, words, "small")

    def line(self, *points: tuple[float, float]) -> None:
        """A line through points."""
        self.parts.append(f'<polyline class="line" points="{" ".join(f"{x:g},{y:g}" for x, y in points)}"/>')

    def dot(self, x: float, y: float) -> None:
        """A node of the circuit."""
        self.parts.append(f'<circle class="head" cx="{x:g}" cy="{y:g}" r="3.5"/>')

    def svg(self) -> str:
        """The whole file."""
        return "\n".join([*self.parts, "</svg>"]) + "\n"


def control_loop() -> str:
    """The plant above, the controller below, the slow loop of estimator and scheduler beside it."""
    d = Drawing(
        980,
        560,
        "The control loop",
        "The bridge feeds the filter and the grid. The inner loops and power loops control it; the estimator and the "
        "scheduler set the gains of the power loops.",
    )
    d.text(490, 30, "Plant (continuous time)", "bold")
    for x, w, lines in (
        (40, 130, ("bridge", "averaged or PWM")),
        (215, 110, ("L_1, R_1", "filter inductor")),
        (370, 120, ("C, R_c", "control point")),
        (535, 110, ("L_2, R_2", "LCL filter only")),
        (690, 110, ("R_g, L_g", "grid")),
        (845, 100, ("source", "V_g, ω_g")),
    ):
        d.box(x, 50, w, 56, "plant", lines)
    for x1, x2 in ((170, 215), (325, 370), (490, 535), (645, 690), (800, 845)):
        d.line((x1, 78), (x2, 78))
    d.text(192, 44, "v_b", "small")
    d.text(347, 44, "i_s", "small")
    d.text(512, 44, "i_g", "small")
    d.text(667, 44, "PCC", "small")
    d.dot(667, 78)

    d.text(250, 505, "Controller (every sampling period T_s)", "bold")
    d.box(40, 200, 130, 64, "control", ("modulation", "delay, duty cycles"))
    d.box(40, 330, 130, 64, "control", ("current loop", "prediction,", "voltage limit"))
    d.box(215, 330, 130, 64, "control", ("voltage loop", "feed-forward,", "current limit"))
    d.box(390, 330, 130, 64, "control", ("power loops", "P → ω, θ", "Q → V"))
    d.box(390, 200, 130, 64, "control", ("measurement", "P, Q, V, filters"))
    d.arrow((105, 200), (105, 106), words="v_b reference", at=(58, 158))
    d.arrow((105, 330), (105, 264), words="v_ref", at=(130, 302))
    d.arrow((215, 362), (170, 362), words="i_ref", at=(192, 352))
    d.arrow((390, 362), (345, 362), words="V, θ", at=(367, 352))
    d.arrow((455, 264), (455, 330), words="P, Q", at=(476, 302))
    d.arrow((430, 106), (430, 200), words="v_c, i_s, i_g", at=(476, 158))
    d.arrow((430, 175), (280, 175), (280, 330), words="v_c, i_s, i_g", at=(328, 225))
    d.dot(430, 175)
    d.arrow((455, 445), (455, 394), words="P_ref, Q_ref", at=(455, 463))

    d.text(770, 505, "Schedule (every 20 ms, or every window)", "bold")
    d.box(690, 200, 170, 64, "slow", ("estimator", "network, RLS, Kalman,", "75 Hz, PRBS, …"))
    d.box(690, 330, 170, 64, "slow", ("scheduler", "guards, place, table,", "Jacobian"))
    d.arrow((667, 106), (667, 160), (775, 160), (775, 200), words="v, i at the PCC (a window)", at=(780, 150))
    d.line((667, 78), (667, 106))
    d.arrow((775, 264), (775, 330), words="R̂_g, L̂_g, status", at=(836, 302))
    d.arrow((520, 232), (600, 232), (600, 350), (690, 350), words="P, Q, V", at=(645, 342))
    d.arrow((690, 376), (520, 376), words="gains, without a jump of ω", at=(605, 396))
    d.arrow((775, 445), (775, 394), words="gain table and certificate (designed off line)", at=(775, 463))
    d.text(
        490,
        540,
        "Orange: plant. Blue: fast control loops. Green: estimation and scheduling of the power-loop gains.",
        "small",
    )
    return d.svg()


GUARDS = (
    ("1 Time", "is the counter going forward?", "refused: the last good values stay"),
    ("2 Inputs", "finite, and within the sensors' range?", "refused: the last good P, Q, V stay"),
    ("3 Box of powers", "P, Q, V inside the certified box?", "clamped: the edge of the box is used"),
    ("4 Plausibility", "R̂_g, L̂_g within the known range?", "held: the goal stays"),
    ("5 Jump", "within 50 % of the goal, seen 3 times, or “changed”?", "held: the jump must be confirmed"),
    ("6 Hysteresis", "more than 2 % from the goal?", "the goal stays (the estimate counts)"),
    ("7 Own error", "is its 95 % set within the designed errors?", "partly: the goal moves part of the way"),
    ("8 Doubt", "no doubt older than 0.6 s?", "fallback: the goal is the safe place"),
    ("9 Rate", "is the place at its goal?", "limited: the place moves at most at r"),
    ("10 Certified box", "is the place inside the box?", "clamped: the edge of the box is used"),
    ("11 Design", "are all nodes used there designed?", "held: place and gains stay"),
)


def scheduler_guards() -> str:
    """One row for each guard: its question, and what happens where the answer is no."""
    step, top = 66, 96
    height = top + step * len(GUARDS) + 150
    d = Drawing(
        860,
        height,
        "The scheduler's guards",
        "Each guard asks one question. If the answer is yes, the update goes on below. If it is no, the box on the "
        "right says what happens.",
    )
    d.box(60, 20, 380, 46, "slow", ("estimate R̂_g, L̂_g; measured P, Q, V; counter",))
    for k, (name, question, otherwise) in enumerate(GUARDS):
        y = top + step * k
        d.arrow((250, y - 30 if k == 0 else y - 22), (250, y))
        d.box(60, y, 380, 44, "control", (name, question))
        d.arrow((440, y + 22), (510, y + 22), words="no", at=(474, y + 16))
        d.box(510, y, 320, 44, "stop", (otherwise,))
        d.text(270, y + 59, "yes", "small")
    y = top + step * len(GUARDS)
    d.arrow((250, y - 22), (250, y + 10))
    d.box(
        60,
        y + 10,
        380,
        62,
        "slow",
        (
            "gains of the place",
            "table → Jacobian (impedance drawn in, Q limited)",
            "→ gains; ω_i is adjusted: no jump of ω",
        ),
    )
    d.arrow((440, y + 41), (510, y + 41))
    d.box(510, y + 10, 320, 62, "slow", ("power loops", "gains, status bits, reason"))
    d.text(
        430,
        y + 105,
        "If an update is refused or held, guards 5 to 7 are skipped and the place moves on to its present goal.",
        "small",
    )
    d.text(
        430, y + 125, "Whatever the inputs are, the gains are those of a place and of powers inside the box.", "small"
    )
    return d.svg()


def files() -> str:
    """What each stage reads and writes."""
    d = Drawing(
        980,
        690,
        "The files that the stages hand over",
        "A datasheet becomes a study; the study becomes inner gains, a gain table with its certificate, and weights; "
        "these become simulation results, a report, and C.",
    )
    for x, words in ((110, "Given"), (370, "Designed or trained"), (640, "Simulated"), (870, "Handed over")):
        d.text(x, 32, words, "bold")
    d.box(30, 60, 160, 46, "file", ("sheet.csv", "datasheet"))
    d.box(30, 136, 160, 40, "control", ("vsgdesign new",))
    d.box(30, 206, 160, 46, "file", ("study.toml", "checked, in SI"))
    d.arrow((110, 106), (110, 136))
    d.arrow((110, 176), (110, 206))
    rows = (
        (60, "vsgdesign inner", "STUDY.inner.json", "inner gains", 46),
        (240, "vsgdesign table build", "TABLE.json", "gains, promises,", 62),
        (430, "estimator train", "WEIGHTS.json", "network", 46),
    )
    for y, verb, name, says, high in rows:
        d.box(270, y, 200, 40, "control", (verb,))
        d.box(290, y + 60, 160, high, "file", (name, says, "certificate") if high > 50 else (name, says))
        d.arrow((370, y + 40), (370, y + 60))
        d.arrow((190, 229), (230, 229), (230, y + 20), (270, y + 20))
    d.box(550, 60, 180, 40, "control", ("vsgdesign simulate",))
    d.box(550, 130, 180, 62, "file", ("results.json", "CONTROLLER.npz, .csv", "every number, hashes"))
    d.arrow((640, 100), (640, 130))
    d.box(550, 250, 180, 40, "control", ("vsgdesign run",))
    d.text(640, 310, "all stages into one folder,", "small")
    d.text(640, 327, "with CONTROLLER.c/", "small")
    d.box(550, 372, 180, 56, "control", ("margins, report", "explore, compare, certify"))
    d.text(640, 446, "linear models over grids", "small")
    d.box(550, 476, 180, 56, "control", ("verify, comply", "survive"))
    d.text(640, 550, "many EMT runs, each judged", "small")
    for y, *_ in rows:
        d.line((450, y + 83), (505, y + 83))
    d.line((505, 80), (505, 630))
    d.arrow((505, 80), (550, 80))
    d.arrow((505, 270), (550, 270))
    d.arrow((505, 400), (550, 400))
    d.arrow((505, 504), (550, 504))
    d.box(790, 130, 160, 62, "slow", ("report.html", "figures/", "for people"))
    d.box(790, 380, 160, 46, "slow", ("page, CSV", "maps, margins"))
    d.box(790, 481, 160, 46, "slow", ("page, PDF, CSV", "verdicts and bounds"))
    d.box(790, 590, 160, 80, "slow", ("CONTROLLER.c/", "C99, known answers,", "INTEGRATION.md,", "manifest.json"))
    d.arrow((730, 161), (790, 161))
    d.arrow((730, 270), (870, 270), (870, 192))
    d.arrow((730, 400), (790, 400))
    d.arrow((730, 504), (790, 504))
    d.box(550, 610, 180, 40, "control", ("vsgdesign export c",))
    d.arrow((505, 630), (550, 630))
    d.arrow((730, 630), (790, 630))
    return d.svg()


if __name__ == "__main__":
    for name, draw in (("control_loop", control_loop), ("scheduler_guards", scheduler_guards), ("files", files)):
        (FOLDER / f"{name}.svg").write_text(draw(), encoding="utf-8")
