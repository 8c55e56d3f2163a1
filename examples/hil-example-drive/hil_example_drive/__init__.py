"""A drive and two models for hil, as another package adds them."""

from hil.stand.devices import Device

DRIVE = Device(
    "the example: a massless motor on a spring, computed in place of a drive",
    "hil_example_drive.drive:SpringDriveConfig",
    "hil_example_drive.drive:SpringDrive",
)
