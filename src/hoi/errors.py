"""The errors a user can meet. Each says what is wrong, where, and what to do."""


class HoiError(Exception):
    """Something outside the program is wrong: a file, a setting, an input."""


class ConfigError(HoiError):
    """A configuration value is missing, unknown or out of range; the message names the key."""


class NoFramesError(ConfigError):
    """A data set has no frames of what is asked for."""


class AssetError(HoiError):
    """A file the run needs (body model, detector weights, mesh) is absent or damaged."""


class ArtifactError(HoiError):
    """A stored artifact does not follow its schema; the message names file and field."""


class FrameFailure(HoiError):
    """One frame cannot pass one stage. It becomes a status in the artifact, never a crash.

    Args:
        status: short machine-readable reason, e.g. ``no_object_detected``.
        detail: one sentence for a person.
    """

    def __init__(self, status: str, detail: str):
        super().__init__(f"{status}: {detail}")
        self.status = status
        self.detail = detail
