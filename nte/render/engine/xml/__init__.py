"""A scene from a Mitsuba XML file, as its author wrote it, moved by keyframes."""
