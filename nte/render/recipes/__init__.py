"""From a recipe to a folder of clips: what to render, in which processes, into which files."""
