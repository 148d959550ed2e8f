#!/usr/bin/env bash
# Trains 3DGS on one scene with its official code, and renders and times the test views. Needs CUDA 11.8 or newer.
# 2DTS starts from the centres of this model. The paper shows 3DGS itself on Mip-NeRF 360 alone.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

make_environment() {
  run conda env create -y -p "$env" -f "$code/environment.yml"
}
train_model() {
  train python train.py -s "$scene" -i "$images" -m "$model" --quiet "${flags[@]}"
}

begin https://github.com/graphdeco-inria/gaussian-splatting main
[ $dataset != dtu ] || prepare halved images 2
once "$model/.trained" train_model
once "$model/.rendered" evaluate render.py --iteration 30000 -s "$scene" -m "$model" --eval --skip_train --quiet
