#!/usr/bin/env bash
# Trains DiffSoup on one scene with its official code, which renders the test views itself. Needs CUDA 12.4.
# Its README has the training on Mip-NeRF 360 at a quarter of the size; here it is the size that is compared.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

begin https://github.com/kenji-tojo/diffsoup c74e35d
run conda create -y -p "$env" python=3.10
inside . pip install torch torchvision # as built for CUDA 12.4
inside . pip install -v .
inside . pip install -r requirements.txt
train python examples/01_mip360.py --scene_root "$scene" --downscale "$divisor" --out_dir "$model"
# The views are called NNNN_NAME_pred.png, and NAME.png is wanted.
# shellcheck disable=SC2016
run bash -c 'mkdir -p "$2" && for file in "$1"/test_views/*_pred.png; do
  view=$(basename "$file" _pred.png)
  cp "$file" "$2/${view#*_}.png"
done' bash "$model" "$renders"
finish diffsoup "$model" "$renders"
