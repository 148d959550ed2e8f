#!/usr/bin/env bash
# Trains 3DGS on one scene with its official code, and renders the test views. Needs CUDA 11.8.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

begin https://github.com/graphdeco-inria/gaussian-splatting 54c035f
run conda env create -y -p "$env" -f "$code/environment.yml"
inside . pip install submodules/diff-gaussian-rasterization submodules/simple-knn submodules/fused-ssim
train python train.py -s "$scene" -i "$images" -m "$model" --quiet --eval --test_iterations -1 # full_eval.py
inside . python render.py --iteration 30000 -s "$scene" -m "$model" --eval --skip_train --quiet
finish three_dgs "$model" "$model/test/ours_30000/renders"
