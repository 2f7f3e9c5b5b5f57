"""The one kind of error about input; apart from `kilnflight.checks`, which takes pandas along."""


class InputError(ValueError):
    """Input that cannot be used; the message says what, where and what to do."""
