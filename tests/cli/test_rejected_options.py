"""Options that contradict each other or have no effect are usage errors that name the option."""

import shlex

import pytest

from tests.cli.conftest import INSTALLED, Refused

REJECTED = """
    audit                                                        Missing
    audit --version y                                            --version
    audit --explain faces y                                      --explain
    audit --explain faces --csv -                                --csv
    audit --explain faces --elements e.csv                       --elements
    audit --explain faces --profile game                         --profile
    audit --explain faces --fail-on faces>1                      --fail-on
    audit --explain faces --fail-on-verdict bad                  --fail-on-verdict
    audit --version --explain faces                              --explain
    audit --version --fail-on faces>1                            --fail-on
    audit --version --json -                                     --json
    audit --version --jsonl -                                    --jsonl
    audit --version --csv -                                      --csv
    audit --weld -1 y                                            --weld
    bake y                                                       Missing
    bake -o a.glb --scene s --cameras c y                        --cameras
    bake -o a.glb --image-folder i y                             --image-folder
    bake -o a.glb --size 9x9 y                                   --size
    bench --camera 0 y                                           --camera
    bench --fail-slower 10% y                                    --fail-slower
    compare y                                                    Missing
    compare --html a.html --camera 0 y                           --camera
    compare --html a.html --image-folder i y                     --image-folder
    compare --html a.html --scale 2 y                            --scale
    convert --official --form folder data_stubs/checkpoint z     --form
    convert --official --up +y data_stubs/checkpoint z           --up
    convert --official --color srgb data_stubs/checkpoint z      --color
    convert --official --texture png data_stubs/checkpoint z     --texture
    convert --official --for web data_stubs/checkpoint z         --for
    convert --for web --color srgb data_stubs/checkpoint z.glb   --color
    convert --for web --texture png data_stubs/checkpoint z.glb  --texture
    convert --texture jpeg data_stubs/checkpoint a.ply           --texture
    convert --color srgb data_stubs/checkpoint a.stl             --color
    convert --to ply data_stubs/checkpoint a.ply                 --to
    render y                                                     Missing
    render -o o y                                                Missing
    render --film a.gif --turntable 2 --depth y                  --depth
    render --film a.gif --turntable 2 --ids y                    --ids
    render --film a.gif --turntable 2 --format npy y             --format
    render --film a.gif --turntable 2 --name {index} y           --name
    render -o o --scene s --cameras c y                          --cameras
    render -o o --scene s --turntable 2 y                        --turntable
    render -o o --scene s --flight 2 y                           --flight
    render -o o --scene s --size 9x9 y                           --size
    render -o o --turntable 2 --image-folder i y                 --image-folder
    render -o o --turntable 2 --cameras c y                      --cameras
    render -o o --turntable 2 --camera 0 y                       --camera
    render -o o --turntable 2 --flight 2 y                       --flight
    render -o o --turntable 2 --fps 30 y                         --fps
    render -o o --cameras c --up +y y                            --up
    render -o o --cameras c --tier both --film a.gif y           --film
    render -o o --cameras c --tier both --renderer standard y    --renderer
    repair y                                                     Missing
    repair y z.ply -o x.ply                                      --out
    repair --compare y --maps m.npz                              --maps
    repair --compare y --fail-on faces>1                         --fail-on
    repair --compare y --fail-on-verdict bad                     --fail-on-verdict
    repair --compare y --with pymeshlab                          --with
    repair --task uv y z.ply                                     --task
    report                                                       Missing
    report --paper tests                                         --paper
    report --paper --view 2                                      --view
    report --paper --published f                                 --published
    report --paper --against p                                   --against
    report --paper --allow-mixed                                 --allow-mixed
    report --paper --table mesh_connectivity -o o                --out
    run                                                          Missing
    run --example paper p                                        PROTOCOL
    run --example paper --scene s                                --scene
    run --example paper --jobs 2                                 --jobs
    run --example paper --only a                                 --only
    run --example paper --redo                                   --redo
    run --example paper --dry-run                                --dry-run
    run --example paper --json -                                 --json
    run --non-engine d p.toml                                    --non-engine
    run --image-folder i p.toml                                  --image-folder
    scenes --rules x y                                           --rules
    scenes -r 0 y                                                --resolution
    trial --camera 0 y                                           --camera
    trial --weld -1 y                                            --weld
    validate                                                     Missing
    validate --explain all y                                     --explain
    view --repaired r --figure f.png y                           --figure
    web y                                                        Missing
    web --verify p.html -o a.html                                --out
    web --verify p.html y                                        ASSET
    web --verify p.html --cameras c                              --cameras
    web --verify p.html --renders r                              --renders
    web --verify p.html --up +z                                  --up
    web --verify p.html --set gamma=1                            --set
    web --verify p.html --background white                       --background
    web --verify p.html --tier standard                          --tier
    web --verify p.html --quantise                               --quantise
    web --verify p.html --no-verify                              --no-verify
    web -o a.html --at-least 30 y                                --at-least
    web -o a.html --device cpu y                                 --device
    web -o a.html --tier dedicated                               --tier
    web -o a.html --cameras c                                    --cameras
    web -o a.html --set gamma=1                                  --set
    web -o a.html --up +y                                        --up
    web -o a.html --camera 0 y                                   --camera
    web -o a.html --size 9x9 y                                   --size
    web -o a.html --tier dedicated --renders r y                 --renders
    web -o a.html --quantise y                                   --quantise
    web -o a.html --faces 9 y                                    --faces
    web -o a.html --baked b y                                    --baked
    web -o a.html --no-verify y                                  --no-verify
    web -o a.html --json - y                                     --json
    why --camera 0 y                                             --camera
"""
CASES = [line.rsplit(maxsplit=1) for line in REJECTED.strip().splitlines()]


@pytest.mark.parametrize(
    ("line", "label"), [(line.strip(), label) for line, label in CASES if line.split()[0] in INSTALLED]
)
def test_the_option_is_rejected_before_anything_is_read(refused: Refused, line: str, label: str) -> None:
    code, first, *_ = refused(shlex.split(line)).split()
    assert (code, first.rstrip(":")) == ("USAGE:", label)
