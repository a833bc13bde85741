"""Small drawings of the page: an interval on its column's axis, and the figures of a method."""

from collections.abc import Sequence

from racines_data.escape import html

WIDTH = 88
"""Of an interval's drawing, in its own units."""
_EDGE = 4


def interval_svg(
    value: float, low: float | None, high: float | None, axis: tuple[float, float]
) -> str:
    """Return a value and its interval on the axis of its column; the number stands beside it."""

    def at(x: float) -> str:
        share = (x - axis[0]) / (axis[1] - axis[0])
        return f"{_EDGE + (WIDTH - 2 * _EDGE) * min(max(share, 0.0), 1.0):.1f}"

    bar = ""
    if low is not None and high is not None:
        bar = f'<path class="r" d="M{at(low)} 6H{at(high)}"/>'
    zero = f'<path class="z" d="M{at(0)} 1V11"/>' if axis[0] < 0 < axis[1] else ""
    # The axis is alike in all of them: the style sheet draws it, behind.
    return (
        f'<svg class="i" viewBox="0 0 {WIDTH} 12" aria-hidden="true">{zero}{bar}'
        f'<circle cx="{at(value)}" cy="6" r="3"/></svg>'
    )


Bar = tuple[str, float, float | None, float | None, str]
"""A label, a share of 0 to 1, the ends of its interval, and the number as text."""


def bars_svg(label: str, bars: Sequence[Bar]) -> str:
    """Return shares as a bar chart with intervals, 0 to 1 from left to right."""
    left, width, step = 96, 140, 20
    height = step * len(bars) + 4
    parts = []
    for row, (name, value, low, high, told) in enumerate(bars):
        y = row * step + 12
        end = left + width * min(max(value, 0.0), 1.0)
        parts.append(f'<text x="{left - 8}" y="{y + 4}" text-anchor="end">{html(name)}</text>')
        parts.append(f'<path class="t" d="M{left} {y}H{left + width}"/>')
        if value > 0:
            parts.append(f'<path class="b" d="M{left} {y}H{end:.1f}"/>')
        if low is not None and high is not None:
            ends = [left + width * min(max(each, 0.0), 1.0) for each in (low, high)]
            parts.append(f'<path class="w" d="M{ends[0]:.1f} {y}H{ends[1]:.1f}"/>')
        parts.append(f'<text x="{left + width + 8}" y="{y + 4}">{html(told)}</text>')
    words = "; ".join(f"{name} {told}" for name, *_, told in bars)
    return (
        f'<svg class="g" viewBox="0 0 300 {height}" role="img" '
        f'aria-label="{html(f"{label}: {words}")}">{"".join(parts)}</svg>'
    )
