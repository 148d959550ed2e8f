"use strict";
import { matrixOf } from "./camera.js";
// Executes the plan of a frame (msb/engines/hardware/program.py) with WebGPU.
// WGSL, buffers and passes are the same as in the renderer `wgpu`.
// For each frame, this script only computes the uniform buffer of the camera.
const SLOT = 256;        // bytes between the entries of a uniform buffer
const PIXEL_BYTES = 20;  // red, green, blue, alpha and depth of a pixel, float32
const ROOM = 1 << 23;    // maximum number of samples of a band
const TILE = 16;         // width and height of an official tile in pixels
const NUMBERS = "r32uint";      // format of targets with face numbers, in plans with a z-buffer
const STORED = "r32float";      // format of textures that compute passes write
const DEPTHS = "depth32float";  // format of the z-buffer

// The shader that copies the pixels of a band to the canvas, rounded to bytes.
const PRESENT = `
struct Band { first: vec2<u32>, size: vec2<u32>, output: u32 }
@group(0) @binding(0) var<uniform> band: Band;
@group(0) @binding(1) var<storage, read> pixels: array<f32>;
@vertex fn corner(@builtin(vertex_index) k: u32) -> @builtin(position) vec4<f32> {
  return vec4<f32>(f32(k & 1u) * 4.0 - 1.0, f32(k >> 1u) * 4.0 - 1.0, 0.5, 1.0);
}
@fragment fn color(@builtin(position) place: vec4<f32>) -> @location(0) vec4<f32> {
  let here = vec2<u32>(place.xy) - band.first;
  let at = 5u * (here.y * band.size.x + here.x);
  let rgb = clamp(vec3<f32>(pixels[at], pixels[at + 1u], pixels[at + 2u]), vec3<f32>(0.0), vec3<f32>(1.0));
  return vec4<f32>(floor(rgb * 255.0 + 0.5) / 255.0, 1.0);
}`;

// ---- the uniform buffer of the camera

// Returns the signs of the rows of world_to_camera, and the projection matrix of blended methods
// (msb/render/splat/view.py).
function blendedProjection(view, near, far) {
  const f = Math.fround, tan = [view.width / (2 * view.fx), view.height / (2 * view.fy)];
  return [[1, 1, 1, 1], [
    [f(2 * near / (2 * (tan[0] * near))), 0, 0, 0], [0, f(2 * near / (2 * (tan[1] * near))), 0, 0],
    [0, 0, f(far / (far - near)), f(-(far * near) / (far - near))], [0, 0, 1, 0],
  ]];
}

// Returns the signs and the projection matrix of DiffSoup, as in its native_model.py.
// With `flip` (layout "synthetic") the matrix is computed in double precision and rounded once.
function surfaceProjection(view, near, far, flip) {
  const f = Math.fround, g = flip ? (x) => x : f;
  const [w, h, fx, fy, cx, cy] = [view.width, view.height, view.fx, view.fy, view.cx, view.cy].map(g);
  return [[1, flip ? -1 : 1, -1, 1], [
    [f(g(2 * fx) / w), 0, f(1 - g(2 * g(cx / w))), 0], [0, f(g(2 * fy) / h), f(g(2 * g(cy / h)) - 1), 0],
    [0, 0, f((far + near) / (near - far)), f(2 * far * near / (near - far))], [0, 0, -1, 0],
  ]];
}

// Returns the members of the camera's buffer that all methods share.
// The formulas and float32 roundings follow msb/render/splat/view.py. camera.js describes a view.
function cameraMembers(view, scale, near, far, methodValues) {
  const f = Math.fround, W = matrixOf(view).map((row) => row.map(f));
  const tan = [view.width / (2 * view.fx), view.height / (2 * view.fy)];
  const [signs, P] = "flip" in methodValues ? surfaceProjection(view, near, far, methodValues.flip)
    : blendedProjection(view, near, far);
  const full = P.map((row) => [0, 1, 2, 3].map((column) => {
    let sum = f(row[0] * signs[0] * W[0][column]);
    for (let k = 1; k < 4; k += 1) sum = f(sum + f(row[k] * signs[k] * W[k][column]));
    return sum;
  }));
  const width = scale * view.width, height = scale * view.height;
  return {
    world_to_camera: W.slice(0, 3).flat(), full: full.flat(), center: cameraCenter(W), zero: [0], tan_fov: tan,
    shift: [scale * (view.cx - view.width / 2), scale * (view.cy - view.height / 2)],
    width: [width], height: [height], columns: [Math.ceil(width / TILE)], rows: [Math.ceil(height / TILE)],
  };
}

// Returns the centre of the camera, -R^-1 t.
// The inverse is computed by cofactors, because a float32 rotation is not exactly orthogonal.
function cameraCenter(W) {
  const [a, b, c] = W;
  const cross = (u, v) => [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const columns = [cross(b, c), cross(c, a), cross(a, b)];
  const determinant = a[0] * columns[0][0] + a[1] * columns[0][1] + a[2] * columns[0][2];
  return [0, 1, 2].map((i) => -(columns[0][i] * a[3] + columns[1][i] * b[3] + columns[2][i] * c[3]) / determinant);
}

// Returns the uniform buffer of the camera as bytes.
function viewRecord(about, scale, view, background, degree, methodValues) {
  const values = { ...cameraMembers(view, scale, about.near, about.far, methodValues), background, degree: [degree] };
  for (const [name, value] of Object.entries(methodValues)) values[name] = [value];
  const data = new DataView(new ArrayBuffer(about.bytes));
  const write = { f32: "setFloat32", i32: "setInt32", u32: "setUint32" };
  for (const [name, type, count, offset] of about.members) {
    for (let k = 0; k < count; k += 1) data[write[type]](offset + 4 * k, values[name][k], true);
  }
  return data.buffer;
}

// ---- a device

async function openDevice(needs) {
  if (!navigator.gpu) throw new Error("This browser does not support WebGPU.");
  let adapter = null;
  // Try several times, because the browser's graphics process may be restarting.
  for (let tries = 0; !adapter && tries < 4; tries += 1) {
    if (tries) await new Promise((done) => setTimeout(done, 200 * tries));
    adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
  }
  if (!adapter) throw new Error("WebGPU found no graphics adapter in this browser.");
  const requiredLimits = { maxTextureDimension2D: adapter.limits.maxTextureDimension2D };
  for (const [name, wanted] of Object.entries(needs)) {
    if (adapter.limits[name] < wanted) {
      const mib = (bytes) => `${Math.ceil(bytes / 1048576)} MiB`;
      throw new Error(`This model needs a buffer of ${mib(wanted)}; this graphics adapter allows ${mib(adapter.limits[name])}.`);
    }
    requiredLimits[name] = wanted;
  }
  const blends = adapter.features.has("float32-blendable");
  const device = await adapter.requestDevice({
    requiredLimits, requiredFeatures: blends ? ["float32-blendable"] : [],
  });
  const info = adapter.info || {};
  const words = [info.vendor, info.architecture, info.description].filter(Boolean).join(" ");
  const name = words.replace("google swiftshader", "SwiftShader") || "unnamed adapter";
  return { device, name, format: blends ? "rgba32float" : "rgba16float" };
}

// ---- the plan

export class Dedicated {
  // Prepares a model.
  // `about` is the object scene.dedicated of the page.
  // `read(name)` returns a promise of an array.
  // `onProgress(text)` is called with progress messages.
  static async open(about, canvas, read, onProgress) {
    const result = new Dedicated();
    Object.assign(result, { about, canvas, held: new Map(), compiled: new Map(), groups: new Map(), size: null });
    Object.assign(result, await openDevice(about.needs));
    if (about.plans[0].format === NUMBERS) result.format = NUMBERS;
    result.lost = result.device.lost;
    // Operations on a lost device may never finish.
    const lost = result.lost.then((info) => { throw new Error(`The graphics device was lost: ${info.message}`); });
    return Promise.race([lost, result.#prepare(canvas, read, onProgress)]);
  }

  async #prepare(canvas, read, onProgress) {
    this.canvasFormat = navigator.gpu.getPreferredCanvasFormat();
    await this.#checked(async () => {
      await this.#upload(read, onProgress);
      onProgress("compiling shaders ...");
      await this.#makePresent();
    });
    await this.use(0);
    this.context = canvas.getContext("webgpu");
    this.context.configure({
      device: this.device, format: this.canvasFormat, alphaMode: "opaque",
      usage: GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC,
    });
    return this;
  }

  // Calls `create`, which creates objects on the device, and throws an error if the device rejects them.
  async #checked(create) {
    this.device.pushErrorScope("validation");
    this.device.pushErrorScope("out-of-memory");
    const result = await create();
    for (const problem of ["is out of memory", "rejects the shaders or buffers of this model"]) {
      const error = await this.device.popErrorScope();
      if (error) throw new Error(`${this.name} ${problem}: ${error.message.slice(0, 200)}`);
    }
    return result;
  }

  // Compiles the plan with this number; later frames use the plan.
  async use(number) {
    this.wanted = number;
    if (!this.compiled.has(number)) this.compiled.set(number, this.#checked(() => this.#compile(this.about.plans[number])));
    const compiled = await this.compiled.get(number).catch((error) => {
      if (this.wanted === number) this.wanted = this.number;  // the earlier plan stays in use
      throw error;
    });
    if (this.wanted !== number) return;  // another plan was chosen during compilation
    const before = this.plan?.buffers || {};
    Object.assign(this, compiled, { number, plan: this.about.plans[number], size: null });
    const { arrays, buffers } = this.plan;
    // Destroy buffers of the earlier plan that the new plan does not use, then create the missing buffers.
    for (const name of Object.keys(before)) {
      if (this.held.has(name) && !(name in buffers && buffers[name][0] === before[name][0]) && !this.about.arrays[name]) {
        this.held.get(name).destroy();
        this.held.delete(name);
      }
    }
    for (const [name, [bytes, usages]] of Object.entries(buffers)) {
      if (!(name in arrays) && !this.held.has(name)) this.#buffer(name, bytes, usages);
    }
    this.groups.clear();
  }

  #buffer(name, size, usages) {
    this.held.get(name)?.destroy();
    const usage = usages.reduce((sum, word) => sum | GPUBufferUsage[word.toUpperCase()], 0);
    const buffer = this.device.createBuffer({ size, usage });
    this.held.set(name, buffer);
    return buffer;
  }

  // Uploads the arrays of all plans.
  // The buffer of an array has the name of the array.
  async #upload(read, onProgress) {
    const wanted = new Map();
    for (const { arrays, buffers } of this.about.plans) {
      for (const [buffer, array] of Object.entries(arrays)) wanted.set(array, buffers[buffer]);
    }
    let k = 0;
    for (const [array, [bytes, usages]] of wanted) {
      onProgress(`reading the model: ${Math.round(100 * k / wanted.size)} %`);
      this.device.queue.writeBuffer(this.#buffer(array, bytes, usages), 0, await read(array));
      k += 1;
    }
  }

  // Returns the buffer or texture that the current plan calls `name`.
  #of(name) { return this.held.get(this.plan.arrays[name] ?? name); }

  // Explicit layouts are needed because a stage may bind resources that it does not use.
  #layout(step) {
    const stages = GPUShaderStage;
    const visibility = step.records ? stages.VERTEX | stages.FRAGMENT : stages.COMPUTE;
    const kinds = {
      uniform: { buffer: { type: "uniform" } }, read: { buffer: { type: "read-only-storage" } },
      write: { buffer: { type: "storage" } }, texture: { texture: { sampleType: "unfilterable-float" } },
      numbers: { texture: { sampleType: "uint" } },
      store: { storageTexture: { format: STORED, access: "write-only" } },
    };
    const entries = step.bindings.map(({ number, kind }) => ({ binding: number, visibility, ...kinds[kind] }));
    return this.device.createBindGroupLayout({ entries });
  }

  async #pipeline(plan, step, module) {
    const group = this.#layout(step), layout = this.device.createPipelineLayout({ bindGroupLayouts: [group] });
    if (!step.records) {
      const compute = { module, entryPoint: step.entry };
      return { group, pipeline: await this.device.createComputePipelineAsync({ layout, compute }) };
    }
    const [color, alpha] = plan.blend.map(([srcFactor, dstFactor]) => ({ srcFactor, dstFactor, operation: "add" }));
    const blended = step.z_buffer ? {} : { blend: { color, alpha } };
    const targets = step.targets.map(() => ({ format: this.format, ...blended }));
    const attributes = Array.from({ length: step.members }, (_, i) =>
      ({ format: "float32x4", offset: 16 * i, shaderLocation: i }));
    const buffers = [{ arrayStride: 16 * step.members, stepMode: "instance", attributes }];
    const pipeline = await this.device.createRenderPipelineAsync({
      layout, primitive: { topology: "triangle-strip" }, vertex: { module, entryPoint: "corner", buffers },
      fragment: { module, entryPoint: step.z_buffer ? "nearest" : "blend", targets },
      depthStencil: step.z_buffer ? { format: DEPTHS, depthWriteEnabled: true, depthCompare: "less" } : undefined,
    });
    return { group, pipeline };
  }

  async #compile(plan) {
    const modules = {};
    for (const [name, text] of Object.entries(plan.modules)) {
      modules[name] = this.device.createShaderModule({ code: this.about.modules[text] });
    }
    const steps = [...plan.passes, ...plan.band_passes];
    // Steps with the same entry point and layout share a pipeline, because compiling is slow.
    const shared = new Map();
    const results = await Promise.all(steps.map((step) => {
      const key = JSON.stringify([step.module, step.entry, step.bindings.map(({ number, kind }) => [number, kind])]);
      if (!shared.has(key)) shared.set(key, this.#pipeline(plan, step, modules[step.module]));
      return shared.get(key);
    }));
    return { steps, layouts: results.map(({ group }) => group), pipelines: results.map(({ pipeline }) => pipeline) };
  }

  async #makePresent() {
    const module = this.device.createShaderModule({ code: PRESENT });
    this.present = await this.device.createRenderPipelineAsync({
      layout: "auto", vertex: { module, entryPoint: "corner" },
      fragment: { module, entryPoint: "color", targets: [{ format: this.canvasFormat }] },
    });
  }

  // Creates the textures and buffers for frames of this size.
  // All bands share these resources, which have the size of a band.
  #makeTargets(width, height) {
    if (this.size?.[0] === width && this.size[1] === height) return;
    const side = Math.floor(this.device.limits.maxTextureDimension2D / this.plan.scale);
    const columns = Math.min(width, side), samples = columns * this.plan.scale ** 2;
    const most = Math.floor(this.about.needs.maxStorageBufferBindingSize / (PIXEL_BYTES * columns));
    const rows = Math.max(1, Math.min(height, side, most, Math.floor(ROOM / samples)));
    this.bands = [];
    for (let y = 0; y < height; y += rows) {
      for (let x = 0; x < width; x += columns) {
        this.bands.push({ x, y, width: Math.min(columns, width - x), height: Math.min(rows, height - y) });
      }
    }
    const records = new Uint32Array(this.bands.length * SLOT / 4);
    this.bands.forEach((band, k) => records.set([band.x, band.y, band.width, band.height, 0], k * SLOT / 4));
    this.device.queue.writeBuffer(this.#buffer("bands", records.byteLength, ["uniform", "copy_dst"]), 0, records);
    this.#buffer("pixels", PIXEL_BYTES * columns * rows, ["storage"]);
    const targets = new Map();
    for (const step of this.plan.band_passes) {
      for (const name of step.targets || []) targets.set(name, this.format);
      if (step.z_buffer) targets.set("z-buffer", DEPTHS);
      for (const { kind, name } of step.bindings) if (kind === "store") targets.set(name, STORED);
    }
    for (const [name, format] of targets) {
      this.held.get(name)?.destroy();
      this.held.set(name, this.device.createTexture({
        size: [columns * this.plan.scale, rows * this.plan.scale], format, usage: GPUTextureUsage.TEXTURE_BINDING |
          (format === STORED ? GPUTextureUsage.STORAGE_BINDING : GPUTextureUsage.RENDER_ATTACHMENT),
      }));
    }
    this.groups.clear();
    this.size = [width, height];
  }

  #group(number, k) {
    const key = `${number} ${k}`;
    if (!this.groups.has(key)) {
      const entries = this.steps[number].bindings.map((binding) => {
        const resource = this.#of(binding.name);
        if (resource instanceof GPUTexture) return { binding: binding.number, resource: resource.createView() };
        const offset = binding.name === "bands" ? SLOT * k : binding.offset;
        return { binding: binding.number, resource: { buffer: resource, offset, size: binding.size ?? resource.size - offset } };
      });
      this.groups.set(key, this.device.createBindGroup({ layout: this.layouts[number], entries }));
    }
    return this.groups.get(key);
  }

  #compute(pass, number, k) {
    const step = this.steps[number], band = this.bands[k];
    pass.setPipeline(this.pipelines[number]);
    pass.setBindGroup(0, this.#group(number, k));
    if (step.indirect !== null) pass.dispatchWorkgroupsIndirect(this.held.get("arguments"), step.indirect);
    else if (step.groups !== null) pass.dispatchWorkgroups(step.groups);
    else pass.dispatchWorkgroups(Math.ceil(band.width / 64), band.height);
  }

  #draw(encoder, number, k) {
    const step = this.steps[number], { width, height } = this.bands[k], scale = this.plan.scale;
    const loadOp = step.load;
    const pass = encoder.beginRenderPass({
      colorAttachments: step.targets.map((target) => ({
        view: this.held.get(target).createView(), loadOp, storeOp: "store", clearValue: [0, 0, 0, this.plan.clear],
      })),
      depthStencilAttachment: step.z_buffer ? {
        view: this.held.get("z-buffer").createView(), depthLoadOp: loadOp, depthStoreOp: "store", depthClearValue: 1,
      } : undefined,
    });
    pass.setViewport(0, 0, scale * width, scale * height, 0, 1);
    pass.setScissorRect(0, 0, scale * width, scale * height);
    pass.setPipeline(this.pipelines[number]);
    pass.setBindGroup(0, this.#group(number, k));
    for (const [records, offset] of step.records) {
      pass.setVertexBuffer(0, this.held.get(records));
      pass.drawIndirect(this.held.get("arguments"), offset);
    }
    pass.end();
  }

  // Copies band `k` to the canvas.
  #show(encoder, texture, k) {
    const band = this.bands[k];
    const pass = encoder.beginRenderPass({
      colorAttachments: [{ view: texture.createView(), loadOp: k ? "load" : "clear", storeOp: "store" }],
    });
    pass.setScissorRect(band.x, band.y, band.width, band.height);
    pass.setPipeline(this.present);
    pass.setBindGroup(0, this.device.createBindGroup({
      layout: this.present.getBindGroupLayout(0),
      entries: [
        { binding: 0, resource: { buffer: this.held.get("bands"), offset: SLOT * k, size: 32 } },
        { binding: 1, resource: { buffer: this.held.get("pixels") } },
      ],
    }));
    pass.draw(3);
    pass.end();
  }

  // Draws onto the canvas.
  // If the destination buffer `copy` is given, the bytes of the canvas are copied to this buffer.
  #encode(view, background, degree, methodValues, copy) {
    const { canvas, device } = this;
    if (canvas.width !== view.width || canvas.height !== view.height) {
      canvas.width = view.width;
      canvas.height = view.height;
    }
    this.#makeTargets(view.width, view.height);
    const record = viewRecord(this.about.view, this.plan.scale, view, background, degree, methodValues);
    device.queue.writeBuffer(this.held.get("view"), 0, record);
    const encoder = device.createCommandEncoder(), texture = this.context.getCurrentTexture();
    const computing = encoder.beginComputePass();
    for (let number = 0; number < this.plan.passes.length; number += 1) this.#compute(computing, number, 0);
    computing.end();
    for (let k = 0; k < this.bands.length; k += 1) {
      for (let number = this.plan.passes.length; number < this.steps.length; number += 1) {
        if (this.steps[number].records) { this.#draw(encoder, number, k); continue; }
        const pass = encoder.beginComputePass();
        this.#compute(pass, number, k);
        pass.end();
      }
      this.#show(encoder, texture, k);
    }
    if (copy) encoder.copyTextureToBuffer({ texture }, copy, [view.width, view.height]);
    device.queue.submit([encoder.finish()]);
  }

  // Draws a view; resolves when the frame is complete.
  // `methodValues` has the method's members of the camera's buffer.
  async draw(view, background, degree, methodValues) {
    this.#encode(view, background, degree, methodValues, null);
    await this.device.queue.onSubmittedWorkDone();
  }

  // Draws a view and returns the canvas's pixels: RGB bytes, the top row first.
  async pixels(view, background, degree, methodValues) {
    const stride = Math.ceil(4 * view.width / SLOT) * SLOT;
    const buffer = this.device.createBuffer({
      size: stride * view.height, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ,
    });
    this.#encode(view, background, degree, methodValues, { buffer, bytesPerRow: stride });
    await buffer.mapAsync(GPUMapMode.READ);
    const bytes = new Uint8Array(buffer.getMappedRange()), rgb = new Uint8Array(3 * view.width * view.height);
    const first = this.canvasFormat.startsWith("bgra") ? 2 : 0;
    for (let y = 0, to = 0; y < view.height; y += 1) {
      for (let at = y * stride, end = at + 4 * view.width; at < end; at += 4, to += 3) {
        rgb[to] = bytes[at + first];
        rgb[to + 1] = bytes[at + 1];
        rgb[to + 2] = bytes[at + 2 - first];
      }
    }
    buffer.destroy();
    return rgb;
  }
}
