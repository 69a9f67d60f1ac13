#!/bin/sh
# Renders and imports clips of Blender's to train on: sh datasets/blender/crowd.sh OUT [CLIPS]
# Every fourth has 4 samples per pixel, every eighth 16, the others 1. Clips that are there are kept. PYTHON is one with bpy.
set -e
out=$1
here=$(dirname "$0")
for seed in $(seq 1 "${2:-16}"); do
    spp=1
    [ $((seed % 4)) -ne 0 ] || spp=4
    [ $((seed % 8)) -ne 0 ] || spp=16
    clip=$out/crowd_$seed frames=$out/.frames_$seed
    [ ! -f "$clip/clip.json" ] || continue
    "${PYTHON:-python}" "$here/render_sequence.py" crowd "$frames" --seed "$seed" --frames 8 --size 128x128 \
        --spp $spp --reference-spp 160
    nte import blender "$frames/noisy" --reference "$frames/clean" --out "$clip"
    rm -r "$frames"
done
