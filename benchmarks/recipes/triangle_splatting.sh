#!/usr/bin/env bash
# Trains Triangle-Splatting on one scene with its official code, and renders and times the test views. Needs CUDA 12.6.
# The arguments are those of its bash_scripts and scripts/dtu_eval.py; for NeRF-Synthetic it has none, so its defaults are
# used. On DTU it trains over white, as in the paper, and not over black.
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
  scan*) shapes=500000 ;;
  *) shapes=4000000 ;;
esac
case $dataset-$where in
  mipnerf360-indoor) # bash_scripts/m360_indoor
    more=(--importance_threshold 0.025 --lr_sigma 0.0008 --opacity_lr 0.014 --lambda_normals 0.00004
      --lambda_dist 1 --iteration_mesh 5000 --lambda_opacity 0.0055 --lambda_dssim 0.4
      --lr_triangles_points_init 0.0015 --lambda_size 5e-8)
    ;;
  dtu-*) # scripts/dtu_eval.py
    more=(--depth_ratio 1.0 --lambda_normals 0.0028 --lambda_dist 0.014 --iteration_mesh 25000 --densify_until_iter 25000
      --lambda_opacity 0.0044 --importance_threshold 0.027 --lr_triangles_points_init 0.0015 --lambda_size 0.0 --no_dome)
    ;;
  nerf_synthetic-*) more=(--no_dome) ;;
  *) more=(--outdoor) ;;
esac

make_environment() {
  run conda env create -y -p "$env" -f "$code/requirements.yaml"
  inside . bash compile.sh
  inside submodules/simple-knn pip install .
}
train_model() {
  train python train.py -s "$scene" -i "$images" -m "$model" --quiet "${flags[@]}" --max_shapes "$shapes" "${more[@]}"
}

begin https://github.com/trianglesplatting/triangle-splatting 685ff27
[ $dataset != dtu ] || prepare halved images 2
once "$model/.trained" train_model
once "$model/.rendered" evaluate render.py --iteration 30000 -s "$scene" -m "$model" --eval --skip_train --quiet
