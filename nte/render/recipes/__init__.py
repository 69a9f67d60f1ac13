"""From a recipe to a folder of clips: what to render, by which processes, into which files."""
