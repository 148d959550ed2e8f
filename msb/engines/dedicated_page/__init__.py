"""The page that draws the dedicated tier with WebGPU in a browser: `msb web --tier dedicated`.

- `storage`: compresses arrays for the page and restores them.

- `reduction`: rounds the values of assets, and keeps only the faces that contribute most.

- `page`: creates and reads the page.

- `measurement`: lets a headless browser draw the page, and compares the result with images in the page.

The scripts of the page are in msb/engines/web.
"""
