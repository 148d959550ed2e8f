#!/usr/bin/env bash
# Trains Triangle-Splatting on one scene with its official code, and renders the test views. Needs CUDA 12.6.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

case $name in
  bicycle) shapes=6400000 ;;
  flowers) shapes=5500000 ;;
  garden) shapes=5200000 ;;
  stump) shapes=4750000 ;;
  treehill) shapes=5000000 ;;
  room) shapes=2100000 ;;
  counter) shapes=2500000 ;;
  kitchen) shapes=2400000 ;;
  bonsai) shapes=3000000 ;;
  truck) shapes=2000000 ;;
  train) shapes=2500000 ;;
esac
if [ "$where" = indoor ]; then # bash_scripts/m360_indoor
  more=(--importance_threshold 0.025 --lr_sigma 0.0008 --opacity_lr 0.014 --lambda_normals 0.00004
    --lambda_dist 1 --iteration_mesh 5000 --lambda_opacity 0.0055 --lambda_dssim 0.4
    --lr_triangles_points_init 0.0015 --lambda_size 5e-8)
else
  more=(--outdoor)
fi

begin https://github.com/trianglesplatting/triangle-splatting 685ff27
run conda env create -y -p "$env" -f "$code/requirements.yaml"
inside . bash compile.sh
inside submodules/simple-knn pip install .
train python train.py -s "$scene" -i "$images" -m "$model" --quiet --eval --max_shapes "$shapes" "${more[@]}"
inside . python render.py --iteration 30000 -s "$scene" -m "$model" --eval --skip_train --quiet
finish triangle_splatting "$model" "$model/test/ours_30000/renders"
