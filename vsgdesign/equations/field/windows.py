"""The probe's lines. From the sums of a cycle to each line's equation v = R i + X x + g, and its third difference over
four cycles."""

from __future__ import annotations

from typing import Any, NamedTuple

from vsgdesign.equations.field.data import FieldSettings, LineSums, LockIn
from vsgdesign.equations.frames import rotate, rotate_back

SIGN_1 = 1.0
SIGN_2 = -1.0
"""Signs of the lines. With opposite ones the probe is zero where a cycle begins: a change of its sign is no step."""

SIZE_1 = 1.1
SIZE_2 = 1.7
"""Sizes of the lines at rest, relative to what σ* needs of equal lines (:eq:`field-amplitude`). The second one hardly
moves the mean of the power."""


def second_line(line: Any) -> Any:
    """Speed of the second line, in the flywheel's frame and relative to it: the next one farther from 0."""
    return line + 1.0 if line > 0.0 else line - 1.0


def lines_at(half_re: Any, half_im: Any, whole_re: Any, whole_im: Any, line: Any) -> tuple[Any, Any, Any, Any]:
    """The phasors of both lines (:eq:`field-pairs`), from e^{jφ/2} and e^{jφ}; ``line`` is the speed of the first, 1/2,
    ±5/2 or ±9/2. Returns (first_re, first_im, second_re, second_im)."""
    twice_re, twice_im = rotate(whole_re, whole_im, whole_re, whole_im)
    four_re, four_im = rotate(twice_re, twice_im, twice_re, twice_im)
    far = line > 3.0 or line < -3.0
    by_re = four_re if far else twice_re
    by_im = four_im if far else twice_im
    moved_re, moved_im = rotate(half_re, half_im, by_re, by_im)
    away = line > 1.0 or line < -1.0
    first_re = moved_re if away else half_re
    first_im = moved_im if away else half_im
    second_re, second_im = rotate(whole_re, whole_im, first_re, first_im)
    back = line < 0.0
    first_im = -first_im if back else first_im
    second_im = -second_im if back else second_im
    return first_re, first_im, second_re, second_im


class Window(NamedTuple):
    """Phasors of one line over a cycle, or their third difference: v = R i + X x + the grid, and the probe u, pu."""

    v_re: Any
    v_im: Any
    i_re: Any
    i_im: Any
    x_re: Any
    x_im: Any
    """(di/dt)/omega_n"""
    u_re: Any
    u_im: Any


class History(NamedTuple):
    """The windows of one line in the last three cycles."""

    one: Window
    two: Window
    three: Window
    """The oldest."""


def no_window() -> Window:
    """A window of nothing."""
    return Window(v_re=0.0, v_im=0.0, i_re=0.0, i_im=0.0, x_re=0.0, x_im=0.0, u_re=0.0, u_im=0.0)


def no_history() -> History:
    """A history of nothing."""
    return History(one=no_window(), two=no_window(), three=no_window())


def current_at_the_end(lock: LockIn) -> tuple[Any, Any]:
    """The current where the cycle ended, between two samples. Returns (i_re, i_im)."""
    place = 0.5 - lock.left
    i_re = lock.i_re + place * (lock.i_re - lock.i_before_re)
    i_im = lock.i_im + place * (lock.i_im - lock.i_before_im)
    return i_re, i_im


def window_of(
    sums: LineSums, weight: Any, turns: Any, boundary_re: Any, boundary_im: Any, settings: FieldSettings
) -> Window:
    """The window of a line from its sums (:eq:`field-boundary`).

    ``turns`` is the line's frequency in the stationary frame relative to omega_n. ``boundary`` is the current at the
    end of the cycle less the one at its beginning, both turned back by the line's angle there.
    """
    i_re = sums.i_re / weight
    i_im = sums.i_im / weight
    edge = 1.0 / (settings.omega_n * settings.T_s * weight)
    return Window(
        v_re=sums.v_re / weight,
        v_im=sums.v_im / weight,
        i_re=i_re,
        i_im=i_im,
        x_re=edge * boundary_re - turns * i_im,
        x_im=edge * boundary_im + turns * i_re,
        u_re=sums.u_re / weight,
        u_im=sums.u_im / weight,
    )


def windows_of_cycle(lock: LockIn, settings: FieldSettings) -> tuple[Window, Window, Window]:
    """The windows of a closed cycle: of the fundamental and of both lines. Returns (mean, line_1, line_2)."""
    end_re, end_im = current_at_the_end(lock)
    turns = lock.omega / settings.omega_n
    mean = window_of(lock.mean, lock.weight, turns, end_re - lock.i_start_re, end_im - lock.i_start_im, settings)
    # e^{−jνφ} is +1 or −1 where a cycle begins and the opposite where it ends, for both lines alike.
    sign = 1.0 if lock.half_re > 0.0 else -1.0
    both_re = sign * (end_re + lock.i_start_re)
    both_im = sign * (end_im + lock.i_start_im)
    line_1 = window_of(lock.line_1, lock.weight, (1.0 + settings.line) * turns, both_re, both_im, settings)
    line_2 = window_of(lock.line_2, lock.weight, (1.0 + second_line(settings.line)) * turns, both_re, both_im, settings)
    return mean, line_1, line_2


def third(now: Any, one: Any, two: Any, three: Any) -> Any:
    """The weights 1, 3, 3, 1: because e^{−jνφ} changes its sign from cycle to cycle, this is a third difference."""
    return 0.125 * (now + 3.0 * (one + two) + three)


def third_difference(now: Window, history: History) -> Window:
    """What is not constant, linear or quadratic over four cycles: the probe's response (:eq:`field-difference`)."""
    one, two, three = history.one, history.two, history.three
    return Window(
        v_re=third(now.v_re, one.v_re, two.v_re, three.v_re),
        v_im=third(now.v_im, one.v_im, two.v_im, three.v_im),
        i_re=third(now.i_re, one.i_re, two.i_re, three.i_re),
        i_im=third(now.i_im, one.i_im, two.i_im, three.i_im),
        x_re=third(now.x_re, one.x_re, two.x_re, three.x_re),
        x_im=third(now.x_im, one.x_im, two.x_im, three.x_im),
        u_re=third(now.u_re, one.u_re, two.u_re, three.u_re),
        u_im=third(now.u_im, one.u_im, two.u_im, three.u_im),
    )


def shifted(now: Window, history: History) -> History:
    """The history after one more cycle."""
    return History(one=now, two=history.one, three=history.two)


def residual(window: Window, R: Any, X: Any) -> tuple[Any, Any]:
    """What R and X leave of v. Returns (e_re, e_im)."""
    return window.v_re - R * window.i_re - X * window.x_re, window.v_im - R * window.i_im - X * window.x_im


def instrumented(window: Window, re: Any, im: Any) -> tuple[Any, Any]:
    """A phasor times the conjugate of the probe. Returns (product_re, product_im)."""
    return rotate_back(re, im, window.u_re, window.u_im)
