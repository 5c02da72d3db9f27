"""The check of options that have a least and a largest value, with one form of message for all."""

from __future__ import annotations


def check_bounds(options: object, name: str, least: float, most: float, unit: str = "") -> None:
    """Raise ValueError if the option with this name is not a number from `least` to `most`.

    `unit` follows the bounds in the message, as "m/s".
    """
    value = getattr(options, name)
    if not least <= value <= most:
        bounds = f"{_shown(least)} to {_shown(most)} {unit}".rstrip()
        raise ValueError(f"{name} = {_shown(value)}: must be {bounds}")


def _shown(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"
