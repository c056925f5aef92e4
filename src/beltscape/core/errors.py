"""The exceptions that Beltscape raises, as a tree.

BeltscapeError
├── InputError         a file, folder or value given by the user does not fit
│   └── ArgumentError  a type cannot hold a value that was given to it; also a ValueError
├── OutputError        a result cannot be written to the requested place
├── CalibrationError   the images do not determine a rig
├── ReconstructionError  the frame does not yield a surface
├── MeasureError       the surface does not yield the quantity
├── SettingsError      a setting is unknown or out of bounds
└── KernelError        arrays handed to a kernel do not fit, or no such kernel

Every message is one line that names the file, the value and the fix. Only the CLI turns it into an exit code.
"""


class BeltscapeError(Exception):
    """Root of everything Beltscape raises on purpose."""


class InputError(BeltscapeError):
    """A file, folder or value given by the user does not fit."""


class ArgumentError(InputError, ValueError):
    """A value that was given to a type or function does not fit; the message names the argument."""


class OutputError(BeltscapeError):
    """A result cannot be written to the requested place."""


class CalibrationError(BeltscapeError):
    """The images do not determine a rig."""


class ReconstructionError(BeltscapeError):
    """The frame does not yield a surface."""


class MeasureError(BeltscapeError):
    """The surface does not yield the quantity."""


class SettingsError(BeltscapeError):
    """A setting is unknown or out of bounds."""


class KernelError(BeltscapeError):
    """Arrays handed to a kernel do not fit, or there is no such kernel."""
