"""A user's own scene: a Mitsuba XML file, loaded as its author wrote it and moved by keyframes."""
