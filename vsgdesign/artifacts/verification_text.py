"""A verification in words. The page, the terminal and a gain table say the same sentences.

They read the document of a verification (results.json of ``vsgdesign verify``), whose numbers are in SI units and whose
shares are fractions of one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from vsgdesign.artifacts.definitions import MORE_THAN_HARDWARE
from vsgdesign.errors import share_percent
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS

Document = Mapping[str, Any]


class FigureWords(NamedTuple):
    """How a figure of a case is called and shown."""

    title: str
    unit: str
    """Unit in which it is shown; "1" for a plain number."""
    factor: float
    """What is shown, over what the document has."""


FIGURES = {
    "overshoot": FigureWords("Overshoot", "%", 100.0),
    "settling_s": FigureWords("Settling time", "s", 1.0),
    "recovery_s": FigureWords("Recovery time", "s", 1.0),
    "peak_pu": FigureWords("Peak current", "pu", 1.0),
    "first_peak_pu": FigureWords("Peak current in the first 5 ms", "pu", 1.0),
    "above_s": FigureWords("Time above the current limit", "s", 1.0),
    "limited_s": FigureWords("Time in which the limiter acts", "s", 1.0),
    "swing_rad": FigureWords("Swing of the angle", "rad", 1.0),
}
"""Figures of a case by their names in the document."""

_CASES = 8
"""Numbers of cases that a sentence names."""

_NOTHING = 1e-5
"""Values up to this are shown as zero: 0.001 % or 10 µs are nothing beside any limit."""

PROMISES = {
    "overshoot": "Overshoot",
    "settling": "Settling time",
    "survival": "Survival",
    "current": "Peak current",
}
"""Titles of the promises by their names in the document. Any other has the title of its figure."""

FAMILIES = {
    "step": ("Steps of P_ref or Q_ref", "steps"),
    "grid": ("Jumps of the grid", "jumps of the grid"),
    "phase": ("Phase jumps", "phase jumps"),
    "sag": ("Voltage sags", "sags"),
    "ramp": ("Frequency ramps", "ramps"),
    "reference": ("New references", "new references"),
    "loss": ("Losses of a unit", "losses of a unit"),
}
"""Heading of the families of cases, and what their cases are called."""


def family_words(name: str) -> tuple[str, str]:
    """Heading of a family of cases, and what its cases are called."""
    if name in EVENT_KINDS.steps:
        _, step = EVENT_KINDS.steps[name]
        return step.title, step.noun
    return FAMILIES.get(name, (_capital(name), f"cases of {name.replace('_', ' ')}"))


def families_of(document: Document) -> list[tuple[str, Document]]:
    """The families by name, in the order of FAMILIES: a file may have sorted them."""
    return _in_order(document["families"], FAMILIES)


def promises_of(family: Document) -> list[tuple[str, Document]]:
    """The promises of a family by name, in the order of PROMISES."""
    return _in_order(family["promises"], PROMISES)


def _in_order(found: Document, order: Mapping[str, object]) -> list[tuple[str, Document]]:
    places = list(order)
    return sorted(found.items(), key=lambda item: places.index(item[0]) if item[0] in order else len(places))


def figure_words(name: str) -> FigureWords:
    """Title and unit of a figure. An unknown name is its own title."""
    return FIGURES.get(name, FigureWords(_capital(name), "1", 1.0))


def figure_of(name: str, promise: Document) -> str:
    """The figure that a promise limits."""
    return str(promise.get("figure", name))


def promise_title(name: str, promise: Document) -> str:
    """What a promise is called, as a heading."""
    return PROMISES.get(name) or figure_words(figure_of(name, promise)).title


def promise_about(family: Document, key: str) -> tuple[str, Document] | None:
    """The promise of a family that has a name, or that limits a figure of that name; None where there is none."""
    promises = family.get("promises", {})
    if key in promises:
        return key, promises[key]
    return next(((name, one) for name, one in promises.items() if figure_of(name, one) == key), None)


def family_title(name: str, family: Document) -> str:
    """What a family of cases is called, as a heading."""
    return str(family.get("title") or family_words(name)[0])


def family_noun(name: str, family: Document) -> str:
    """What its cases are called, in the plural."""
    return str(family.get("noun") or family_words(name)[1])


def _capital(name: str) -> str:
    return name[:1].upper() + name[1:].replace("_", " ")


def counted_of(count: int) -> str:
    """A count with thousands apart: 48,211."""
    return f"{count:,}"


def value_text(name: str, value: float | None, digits: int = 3) -> str:
    """A value of a figure with its unit; a dash where there is none."""
    words = figure_words(name)
    if value is None or not math.isfinite(value):
        return "–"
    value = 0.0 if abs(value) <= _NOTHING else value
    unit = "" if words.unit == "1" else f" {words.unit}"
    return f"{words.factor * value:.{digits}g}{unit}"


def most_of(promise: Document) -> float:
    """The largest value that keeps a promise, with the most that noise may do to it in any case; documents of earlier
    versions allow nothing beyond the limit."""
    return float(promise.get("most", promise["limit"])) + float(promise.get("noise", 0.0))


def breaks(value: float, promise: Document) -> bool:
    """Whether a value breaks a promise. One with a limit of its own for steps of Q_ref is broken beyond the larger."""
    return value < promise["limit"] if promise.get("at_least") else value > most_of(promise)


def limit_text(name: str, promise: Document) -> str:
    """What a promise asks for: "≤ 5 %", "≤ 4.6 % (Q: 0 %)", "at rest in 2.8 s"."""
    figure = figure_of(name, promise)
    limit = value_text(figure, promise["limit"])
    if promise.get("survival"):
        return f"at rest in {limit}"
    of_Q = promise.get("limit_Q")
    return f"{'≥' if promise.get('at_least') else '≤'} {limit}" + (
        f" (Q: {value_text(figure, of_Q)})" * (of_Q is not None)
    )


def promise_text(name: str, promise: Document) -> str:
    """A promise with its limit: "Overshoot ≤ 5 %"."""
    comma = ": " if promise.get("survival") else " "
    return f"{promise_title(name, promise)}{comma}{limit_text(name, promise)}"


def share_text(promise: Document) -> str:
    """Share of the judged cases that break a promise, as a percentage."""
    share = promise["share"]
    if share is None:
        return "–"
    return share_percent(share, 2 if share < 0.1 else 3)


def bound_text(promise: Document) -> str:
    """The upper bound of this share: "1 in 10,400", or a percentage above 1 %. Both are rounded to the safe side."""
    bound = promise["bound"]
    if bound is None:
        return "–"
    if bound <= 0.01:
        return f"1 in {counted_of(promise['one_in'])}"
    step = 10.0 ** (math.floor(math.log10(100.0 * bound)) - 2)
    # A hair of slack: 0.05 may be 0.050000000000000003.
    return f"{min(step * math.ceil(100.0 * bound / step * (1.0 - 1e-12)), 100.0):.3g} %"


def promise_sentence(
    family_name: str, family: Document, promise_name: str, promise: Document, confidence: float
) -> str:
    """One promise of one family: how many cases break it, and what is known of all cases that could be drawn.

    The bound is the exact one of :eq:`clopper-pearson`; :eq:`runs-needed` says how many cases it takes.
    """
    title, noun = promise_title(promise_name, promise), family_noun(family_name, family)
    judged, broken = int(promise["judged"]), int(promise["broken"])
    if judged == 0:
        return f"{title}: no {noun} were judged, so nothing is known."
    limit = value_text(figure_of(promise_name, promise), promise["limit"])
    if promise.get("survival"):
        what = f"not at rest in {limit}"
    else:
        what = f"{'below' if promise.get('at_least') else 'above'} {limit_text(promise_name, promise)[2:]}"
    said = f"{title}: {counted_of(broken)} of {counted_of(judged)} {noun} {what}"
    if broken:
        said += f" ({share_text(promise)})"
    return f"{said}; with {confidence_text(confidence)} confidence fewer than {bound_text(promise)} would be."


def confidence_text(confidence: float) -> str:
    """A confidence as a percentage: 0.99 as "99 %"."""
    return f"{100.0 * confidence:.10g} %"


def promise_sentences(document: Document) -> list[str]:
    """One sentence for each family and promise, and one for each family with currents that hardware does not carry."""
    found = []
    for family_name, family in families_of(document):
        for promise_name, promise in promises_of(family):
            found.append(promise_sentence(family_name, family, promise_name, promise, document["confidence"]))
            found += filter(None, [beyond_hardware_text(family_name, family) if promise.get("survival") else ""])
    return found


def beyond_hardware_text(name: str, family: Document) -> str:
    """How many cases of a family are survived with a current that hardware does not carry, and which; empty without."""
    beyond = family.get("beyond_hardware") or {}
    if not beyond.get("survived"):
        return ""
    count, cases = int(beyond["survived"]), beyond["cases"][:_CASES]
    more = ", …" if count > len(cases) else ""
    return (
        f"Survived, but above {beyond['above_pu']:g} pu, {MORE_THAN_HARDWARE}: {counted_of(count)} "
        f"{family_noun(name, family)} (up to {value_text('peak_pu', beyond['largest_pu'])}: "
        f"case{'s' if count > 1 else ''} {', '.join(map(str, cases))}{more})."
    )


def headline(document: Document) -> str:
    """Whether every promise was kept, in how many cases."""
    promises = [promise for family in document["families"].values() for promise in family["promises"].values()]
    broken = [promise for promise in promises if promise["broken"]]
    judged, runs = int(document["judged"]), int(document["runs"])
    of = f"{counted_of(judged)} judged cases, of {counted_of(runs)} drawn"
    if not promises or judged == 0:
        return f"Nothing is known: none of {counted_of(runs)} drawn cases could be judged."
    if not broken:
        return f"Every promise was kept in all of {of}."
    return f"{len(broken)} of {len(promises)} promises were broken at least once in {of}."


def kept(document: Document) -> bool:
    """Whether cases were judged, and no promise was broken in any of them."""
    promises = [promise for family in document["families"].values() for promise in family["promises"].values()]
    return int(document["judged"]) > 0 and not any(promise["broken"] for promise in promises)


def worst_text(name: str, promise: Document) -> str:
    """The worst value, with enough digits to differ from the limit if it does; ∞ where a case has none."""
    figure, worst, limit = figure_of(name, promise), promise["worst"], promise["limit"]
    if worst is None:
        return "∞" if promise["broken"] else "–"
    for digits in range(3, 16):
        text = value_text(figure, worst, digits)
        if worst == limit or text != value_text(figure, limit, digits):
            return text
    return value_text(figure, worst)


def lost_text(name: str, family: Document) -> str:
    """How the lost cases of a family were lost: "Lost jumps of the grid: 2 latched, 1 slipped"; empty if none was."""
    lost = {reason: count for reason, count in (family.get("lost") or {}).items() if count}
    if not lost:
        return ""
    return f"Lost {family_noun(name, family)}: {', '.join(f'{counted_of(n)} {reason}' for reason, n in lost.items())}."


def table_verification(record: Document | None) -> list[str]:
    """What a gain table says of its verification: the answer, then a line for each promise; one line without one."""
    if record is None:
        return ["Not verified: no random cases were simulated with this table (vsgdesign verify)."]
    return [f"Verified in EMT: {_lower(headline(record))}", *promise_sentences(record)]


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]
