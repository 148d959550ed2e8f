#!/usr/bin/env bash
# Trains MeshSplatting on one scene with its official code, and renders the test views. Needs CUDA 12.6.
# Its README also describes priors of normals and depths from other networks; this is the training without them.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

more=()
if [ "$where" = indoor ]; then
  more=(--indoor)
fi

begin https://github.com/meshsplatting/mesh-splatting 608e5d0
run conda create -y -p "$env" -c nvidia/label/cuda-12.6.0 -c conda-forge python=3.11 cuda
inside . pip install torch==2.7.1 torchvision==0.22.1
inside . pip install -r requirements.txt
inside . bash compile.sh
inside submodules/simple-knn pip install . --no-build-isolation
inside submodules/effrdel pip install -e .
train python train.py -s "$scene" -i "$images" -m "$model" --eval "${more[@]}"
inside . python render.py -s "$scene" -m "$model" --eval --skip_train
finish mesh_splatting "$model" "$model/test/ours_30000/renders"
