#!/usr/bin/env bash
# Trains DiffSoup on one scene with its official code, which renders the test views itself. Needs CUDA 12.4.
# It trains at a quarter of the size, as its README and the paper do. Tanks and Temples is packaged at half of
# it, so these photographs are halved into images_4 of a scene of their own.
# shellcheck source-path=SCRIPTDIR
. "$(dirname "$0")/common.sh"

if [ "$images" != images ]; then
  images=images_4
fi

begin https://github.com/kenji-tojo/diffsoup c74e35d
run conda create -y -p "$env" python=3.10
inside . pip install torch torchvision # as built for CUDA 12.4
inside . pip install -v .
inside . pip install -r requirements.txt
if [ "$images" = images ]; then
  halved=$out/halved/$name
  run mkdir -p "$halved/images_4"
  run ln -s "$scene/sparse" "$halved/sparse"
  inside . python -c 'import pathlib, sys
from PIL import Image
for path in sorted(pathlib.Path(sys.argv[1]).iterdir()):
    image = Image.open(path)
    size = round(image.width / 2), round(image.height / 2)
    image.resize(size, Image.Resampling.BICUBIC).save(pathlib.Path(sys.argv[2], path.name), quality=98, subsampling=0)' \
    "$scene/images" "$halved/images_4"
  scene=$halved
fi
train python examples/01_mip360.py --scene_root "$scene" --downscale 4 --out_dir "$model"
# The views are called NNNN_NAME_pred.png, and NAME.png is wanted.
# shellcheck disable=SC2016
run bash -c 'mkdir -p "$2" && for file in "$1"/test_views/*_pred.png; do
  view=$(basename "$file" _pred.png)
  cp "$file" "$2/${view#*_}.png"
done' bash "$model" "$renders"
finish diffsoup "$model" "$renders"
