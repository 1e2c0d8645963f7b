"""What can go wrong, sorted by what the caller can do about it."""


class TrackerdError(Exception):
    """Anything trackerd raises on purpose; its text is fit for a person."""


class ConfigError(TrackerdError):
    """A person edits a file. The text names file, table, key, value and the rule, one line per error."""


class DeviceError(TrackerdError):
    """A device did not do what it was asked. The text says who, doing what, and what came back."""

    def __init__(self, device: str, doing: str, answer: str) -> None:
        super().__init__(f"{device}: {doing}: {answer}")
        self.device = device
        self.doing = doing
        self.answer = answer


class DeviceMissing(DeviceError):
    """Not there (yet): wait and retry."""


class DeviceTimeout(DeviceError):
    """No answer in time: retry, and stop the axes if it goes on."""


class DeviceFault(DeviceError):
    """It answered, and the answer is a fault: stop."""


class RecordingEnded(TrackerdError):
    """A replayed recording has been played to its end: the run is over, nothing is wrong."""


class Degenerate(TrackerdError):
    """The geometry does not determine what was asked (too few or nearly parallel lines of sight)."""


class Undetermined(TrackerdError):
    """The pictures do not determine what was asked; the text says why, and what would."""
