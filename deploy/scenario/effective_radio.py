"""The radio of a run in words: what its settings come to, as it is said when a run begins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

from deploy.scenario.plan import Plan
from deploy.scenario.tables import UNLIMITED
from netshaper.presets import PRESETS
from netshaper.radio_options import RadioOptions


def effective_radio(plan: Plan) -> str:
    """The radio's settings in one line; nothing where a scenario leaves all of them as they are."""
    options = plan.scenario.radio
    if options == RadioOptions() and plan.radio.perfect:
        return ""
    return "radio: " + "; ".join(_words(plan))


def _words(plan: Plan) -> Iterator[str]:
    scenario, options = plan.scenario, plan.scenario.radio
    if options.preset:
        yield f"{options.preset}, {PRESETS[options.preset].words}"
    whose = "each neighbourhood" if options.reuse else "the team"
    rate = scenario.bandwidth if scenario.bandwidth == UNLIMITED else f"{scenario.bandwidth} bytes a step"
    yield f"{rate} for {whose}"
    yield f"range {plan.range_m:.4g} m, {options.model}"
    if options.model == "log-distance":
        yield (
            f"{10 * options.exponent:g} dB a decade, {options.db_per_metre:g} dB a metre, "
            f"{options.db_per_wall:g} dB a wall, shadowing {options.shadowing_db:g} dB"
        )
    if options.burst_every:
        yield (
            f"bursts of {options.burst_steps:g} steps after {options.burst_every:g}, in which "
            f"{100 * options.burst_loss:g} % are lost"
        )
    for begin, end in _steps(options):
        yield f"robots are parted in steps {begin} to {end}"
    if plan.radio.perfect:
        yield "what is put on the air is heard"
        return
    yield "only what a teammate says confirms"
    if options.sums:
        yield "frames with checksums"
    differing = [
        f"{field.name} {getattr(options, field.name):g}"
        for field in fields(RadioOptions)
        if field.name in _PLAIN and getattr(options, field.name) != field.default
    ]
    yield from differing
    for name, limits in (("send_bytes", plan.radio.send), ("receive_bytes", plan.radio.receive)):
        own = [f"robot {robot} {limit}" for robot, limit in enumerate(limits) if limit]
        if own and len(set(limits)) > 1:
            yield f"{name} of {', '.join(own)}"


def _steps(options: RadioOptions) -> list[tuple[int, int]]:
    return [(partition.first, partition.last) for partition in options.partition]


_PLAIN = ("loss", "delay", "jitter", "duplication", "bit_errors", "send_bytes", "receive_bytes", "duty_cycle")
"""Settings that are said as they are."""
