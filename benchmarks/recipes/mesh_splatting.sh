#!/usr/bin/env bash
# Trains MeshSplatting on one scene with its official code, and renders and times the test views. Needs CUDA 12.6.
# Its README also describes priors of normals and depths from other networks; this is the training without them. It has
# no arguments for NeRF-Synthetic and DTU, so its defaults are used.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

more=()
[ $where != indoor ] || more=(--indoor)

make_environment() {
  run conda create -y -p "$env" -c nvidia/label/cuda-12.6.0 -c conda-forge python=3.11 cuda
  inside . pip install torch==2.7.1 torchvision==0.22.1
  inside . pip install -r requirements.txt
  inside . bash compile.sh
  inside submodules/simple-knn pip install . --no-build-isolation
  inside submodules/effrdel pip install -e .
}
train_model() {
  train python train.py -s "$scene" -i "$images" -m "$model" "${flags[@]}" "${more[@]}"
}

begin https://github.com/meshsplatting/mesh-splatting 608e5d0
[ $dataset != dtu ] || prepare halved images 2
once "$model/.trained" train_model
once "$model/.rendered" evaluate render.py --iteration 30000 -s "$scene" -m "$model" --eval --skip_train
