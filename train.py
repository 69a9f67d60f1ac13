"""python train.py configs/x.yaml key=value …: the same as `nte train`."""

import sys

from nte.cli import main

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
