"""Arguments of constructors and methods: what does not fit is an exception that says which, and what was expected."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def as_progress(progress: Callable[[int, int], object] | None) -> Callable[[int, int], object] | None:
    """The argument 'progress' of any method."""
    if progress is not None and not callable(progress):
        raise TypeError(f"argument 'progress': it is a {type(progress).__name__}; expected a function of two numbers")
    return progress


def as_word(name: str, value: object, *words: str) -> str:
    if not isinstance(value, str) or value not in words:
        kind = ValueError if isinstance(value, str) else TypeError
        raise kind(f"argument '{name}': it is {value!r}; expected one of {', '.join(map(repr, words))}")
    return value


def as_positive(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise TypeError(f"argument '{name}': it is a {type(value).__name__}; expected a number above 0")
    if not (0.0 < float(value) < np.inf):
        raise ValueError(f"argument '{name}': it is {value}; expected a number above 0")
    return float(value)


def as_truth(name: str, value: object) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"argument '{name}': it is a {type(value).__name__}; expected True or False")
    return bool(value)
