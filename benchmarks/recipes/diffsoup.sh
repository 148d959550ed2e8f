#!/usr/bin/env bash
# Trains DiffSoup on one scene with its official code, and renders and times the test views. Needs CUDA 12.4.
# It trains at a quarter of the size, as its README and the paper do. Tanks and Temples is packaged at half of it, so
# these photographs are halved. NeRF-Synthetic starts from random triangles, because the other example needs meshes of
# MobileNeRF.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

if [ $dataset = mipnerf360 ] && [ ! -d "$scene/images_4" ]; then
  fail "$scene: it has no folder images_4, which DiffSoup needs"
fi

make_environment() {
  run conda create -y -p "$env" python=3.10
  inside . pip install torch torchvision # as built for CUDA 12.4
  inside . pip install -v .
  inside . pip install -r requirements.txt
}
train_model() {
  if [ $kind = synthetic ]; then
    train python examples/03_random_init.py --scene "$name" --datasets_root "$(dirname "$scene")" --downscale 4 --out_dir "$model"
  else
    train python examples/01_mip360.py --scene_root "$scene" --downscale 4 --out_dir "$model"
  fi
}

begin https://github.com/kenji-tojo/diffsoup c74e35d
case $dataset in
  tanksandtemples) prepare quarter images_4 2 ;;
  dtu) prepare quarter images_4 4 ;;
esac
once "$model/.trained" train_model
once "$model/.rendered" evaluate "$scene" "$model" "$renders"
