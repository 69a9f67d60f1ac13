"""Which motion, found in noisy images alone, brings the clean previous frame closest to the clean current one?

    nte render datasets/correspondence.yaml --out data/correspondence
    python tests/benchmarks/correspondence.py data/correspondence/test [--times] [--json FILE] [--pictures FOLDER]

Returns 1 if what the project promises does not hold. docs/correspondence.md says how each number is computed.
"""

import argparse
import json
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import torch
from gefolki.algorithm import EFolki
from torch import Tensor

from nte.color import display, luminance, sanitise
from nte.evaluation.flow_times import memory_table, time_table
from nte.evaluation.table import aligned
from nte.filters.estimated import matched_grey, search_for
from nte.frames.clip import Clip, find_clips, read_frame, frame_path
from nte.frames.scalars import estimate_exposure
from nte.frames.show import Picture, grid, heat, quantise, write_png
from nte.motion.correspondence import FewerLevelsWarning, find_correspondence
from nte.motion.warp import warp

SIZE = 256  # of the discs
