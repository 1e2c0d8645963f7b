"""trackerd: the position of a probe, in real time, from cameras on two-axis gimbals."""

__version__ = "0.1.0"
