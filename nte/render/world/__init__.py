"""Worlds to render: scenes, cameras, transforms, keyframes and seeds. NumPy only, no Mitsuba."""
