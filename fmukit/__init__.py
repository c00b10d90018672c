"""What turns a page of equations into an FMU; standard library only, but for `slave`."""

VERSION = "0.1.0"
