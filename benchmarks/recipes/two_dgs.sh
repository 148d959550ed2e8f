#!/usr/bin/env bash
# Trains 2DGS on one scene with its official code, renders the test views and extracts the mesh. Needs CUDA 11.8.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

begin https://github.com/hbb1/2d-gaussian-splatting 1920a23
run conda env create -y -p "$env" -f "$code/environment.yml"
inside . pip install submodules/diff-surfel-rasterization submodules/simple-knn
train python train.py -s "$scene" -i "$images" -m "$model" --quiet --eval --test_iterations -1 # scripts/m360_eval.py
inside . python render.py --iteration 30000 -s "$scene" -m "$model" --eval --skip_train --quiet
finish two_dgs "$model" "$model/test/ours_30000/renders"
