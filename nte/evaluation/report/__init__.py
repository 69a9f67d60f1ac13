"""The report of an evaluation: its data, its strips of pictures, and its page."""

PLAYED = 24  # frames of each clip that a report plays, if nobody says otherwise
