"""One exception tree: everything securestate raises on purpose is a `SecurestateError`.

A mistake of the caller is an `InputError` and names the argument, what was expected and what was received.
A plant that a method cannot handle is a `DesignError` with the reason and advice.
A saved filter that does not fit is a `ResumeError`.
"""


class SecurestateError(Exception):
    """Base of every exception raised on purpose by this package."""


class InputError(SecurestateError, ValueError):
    """An argument is wrong.

    Args:
        argument: name of the argument, for example ``"A"`` or ``"sensor 'flow 1': R"``.
        expected: what it should be.
        received: what came instead.

    Examples:
        >>> print(InputError("dt", "a number > 0", "-1.0"))
        dt: expected a number > 0, received -1.0
    """

    def __init__(self, argument: str, expected: str, received: str) -> None:
        super().__init__(argument, expected, received)
        self.argument = argument
        self.expected = expected
        self.received = received

    def __str__(self) -> str:
        return f"{self.argument}: expected {self.expected}, received {self.received}"


class ShapeError(InputError):
    """An array handed to an estimator has the wrong shape."""


class PlantError(InputError):
    """The description of a plant, one of its sensors or its file is wrong (shapes included)."""


class MeasurementError(InputError):
    """A measurement, or a file of measurements, is wrong."""


class DesignError(SecurestateError, ValueError):
    """This plant does not allow this method.

    Args:
        reason: what stands in the way.
        advice: what the engineer can do about it; may be empty.

    Examples:
        >>> print(DesignError("state 'level' is seen by no sensor", "add a sensor that depends on it"))
        state 'level' is seen by no sensor; add a sensor that depends on it
    """

    def __init__(self, reason: str, advice: str = "") -> None:
        super().__init__(reason, advice)
        self.reason = reason
        self.advice = advice

    def __str__(self) -> str:
        return f"{self.reason}; {self.advice}" if self.advice else self.reason


class ResumeError(SecurestateError, ValueError):
    """A saved filter cannot be resumed: it is damaged or belongs to another estimator."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class SecurestateWarning(UserWarning):
    """The result is usable, but something about the data asks for another method or another look."""


class InsecureWarning(SecurestateWarning):
    """The estimator was made, but on this plant a single lying sensor can defeat it."""
