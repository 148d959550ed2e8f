#!/usr/bin/env bash
# Trains 2DGS on one scene with its official code, renders and times the test views, and fuses its mesh. Needs CUDA 11.8.
# The paper evaluates 2DGS on Mip-NeRF 360 alone.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

make_environment() {
  run conda env create -y -p "$env" -f "$code/environment.yml"
}
train_model() {
  train python train.py -s "$scene" -i "$images" -m "$model" --quiet --test_iterations -1 "${flags[@]}"
}

begin https://github.com/hbb1/2d-gaussian-splatting 1920a23
[ $dataset != dtu ] || prepare halved images 2
once "$model/.trained" train_model
once "$model/.rendered" evaluate render.py --iteration 30000 -s "$scene" -m "$model" --eval --skip_train --skip_mesh --quiet
once "$model/.fused" inside . python render.py --iteration 30000 -s "$scene" -m "$model" --skip_train --skip_test --quiet
