"""The page that shows the dedicated tier in a browser's WebGPU: `msb web --tier dedicated`.

- `stored`: arrays as they lie in the page, compressed, and back.
- `smaller`: assets of fewer bytes: rounded values, and only the faces that contribute most.
- `page`: the page itself.
- `measure`: what a headless browser draws of a page, against the reference images in it.

The scripts lie in msb/engines/web.
"""
