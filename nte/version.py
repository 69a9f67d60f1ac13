"""The version of nte, which is also stored in the files that it writes."""

__version__ = "0.1.0"
