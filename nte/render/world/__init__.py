"""What there is to render, and when: scenes, cameras, transforms, keyframes and seeds. NumPy only, no Mitsuba."""
