"""The page that draws the dedicated tier with a browser's WebGPU: `msb web --tier dedicated`.

- `storage`: compresses arrays for the page and restores them.
- `reduction`: makes assets smaller by rounding values and by keeping only the faces that contribute most.
- `page`: creates and reads the page.
- `measurement`: compares the output of a headless browser with the reference images in the page.

The scripts of the page are in msb/engines/web.
"""
