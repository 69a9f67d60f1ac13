"""The viewer of sequences: a page that opens from disk, and the files of pixels that it loads as they are needed."""
