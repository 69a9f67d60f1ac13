#!/bin/sh
# Renders and imports the clip that nte demo shows: sh datasets/blender/toys.sh FRAMES CLIP
# PYTHON is one with bpy. It took 30 minutes on a core. Digits that nobody sees are left out, so that it is small.
set -e
here=$(dirname "$0")
"${PYTHON:-python}" "$here/render_sequence.py" toys "$1" --frames 10 --size 192x108 --reference-spp 512
nte import blender "$1/noisy" --reference "$1/clean" --out "$2"
python "$here/fewer_digits.py" "$2"
