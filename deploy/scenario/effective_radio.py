"""One line of text about the radio of a run, printed when the run begins."""

from __future__ import annotations

from collections.abc import Iterator

from deploy.scenario.plan import Plan
from netshaper.radio_options import LOG_DISTANCE, RadioOptions
from protocol.budget import WORD_FOR_UNLIMITED
from protocol.presets import UNKNOWN, Limit, preset


def effective_radio(plan: Plan) -> str:
    """Return the radio's settings in one line; empty if the scenario changes none of the defaults."""
    options = plan.scenario.radio
    if options == RadioOptions() and plan.radio.perfect:
        return ""
    return "radio: " + "; ".join(_parts(plan))


def _parts(plan: Plan) -> Iterator[str]:
    scenario, options = plan.scenario, plan.scenario.radio
    chosen = preset(options.preset) if options.preset else None
    if chosen is not None:
        yield f"{options.preset}, {chosen.description}"
    sharing = "each neighborhood" if options.reuse else "the team"
    bandwidth = scenario.bandwidth
    rate = bandwidth if bandwidth == WORD_FOR_UNLIMITED else f"{bandwidth} bytes per step"
    yield f"{rate} for {sharing}"
    reach = f"{plan.range_m:.4g} m" if plan.range_m < 1000 else f"{plan.range_m / 1000:.3g} km"
    yield f"range {reach}{' without walls' if options.model == LOG_DISTANCE else ''}, {options.model}"
    if options.model == LOG_DISTANCE:
        yield (
            f"{10 * options.exponent:g} dB per decade, {options.db_per_meter:g} dB per meter, "
            f"{options.db_per_wall:g} dB per wall, shadowing {options.shadowing_db:g} dB"
        )
    if options.burst_every:
        yield (
            f"bursts of {options.burst_steps:g} steps every {options.burst_every:g} steps, in which "
            f"{100 * options.burst_loss:g} % of the frames are lost"
        )
    for each in options.partition:
        yield f"groups of robots out of range of each other in steps {each.first} to {each.last}"
    limit = UNKNOWN if chosen is None else chosen.limit
    if min(options.duty_cycle, limit.duty_cycle) < 1:
        yield _duty_cycle(options.duty_cycle, limit)
    if plan.radio.perfect:
        yield "lossless"
        return
    yield "acknowledgments by teammates"
    if options.sums:
        yield "frames with checksums"
    for name in _PLAIN:
        value = getattr(options, name)
        if value != getattr(RadioOptions, name):
            yield f"{name} {value:g}"
    for name, limits in (("send_bytes", plan.radio.send), ("receive_bytes", plan.radio.receive)):
        own = [f"robot {robot} {limit}" for robot, limit in enumerate(limits) if limit]
        if own and len(set(limits)) > 1:
            yield f"{name} of {', '.join(own)}"


def _duty_cycle(share: float, limit: Limit) -> str:
    """The duty cycle of each robot, and the legal limit."""
    text = f"duty cycle {100 * share:g} %" if share < 1 else "no duty cycle"
    if limit == UNKNOWN:
        return text
    if share == limit.duty_cycle:
        return f"{text}, the limit of {limit.source} (radio.duty_cycle=1 switches it off)"
    allowed = f"{100 * limit.duty_cycle:g} %" if limit.duty_cycle < 1 else "any"
    return f"{text}; {limit.source} allows {allowed}"


_PLAIN = ("loss", "delay", "jitter", "duplication", "bit_errors", "send_bytes", "receive_bytes")
"""Options that are printed as name and value."""
