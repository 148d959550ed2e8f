// A stable radix sort of faces by their depth keys, with 4-bit digits.
// The sort needs no subgroups and no atomics.
// Every invocation counts the digits of a separate run of consecutive items, so equal keys keep their order.
//
// The first step also removes the faces that are not drawn.
// Only the device knows the number of remaining faces.
// The first step therefore also writes the arguments of later dispatches and draws.

const DIGITS = 16u;
const WORKERS = 128u;
const RUN = BLOCK / WORKERS;    // items per invocation; program.py defines BLOCK, the items per workgroup
const UNLISTED = 0xfffffffeu;   // faces with this key or a higher key are not drawn (DROPPED, UNSEEN in project.wgsl)

struct Step {
    shift: u32,
    mask: u32,    // 0 in the single step of the order "none", which keeps the order of the asset
    items: u32,   // number of items of the first step
    blocks: u32,  // maximum number of blocks; stride of `sums`
    chunks: u32,  // number of chunks of sorted faces, which are drawn one after the other
    parts: u32,   // number of record buffers per chunk
}
@group(0) @binding(0) var<uniform> current: Step;
@group(0) @binding(1) var<storage, read> keys_in: array<u32>;
#if !FIRST
@group(0) @binding(2) var<storage, read> faces_in: array<u32>;
#endif
@group(0) @binding(3) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(4) var<storage, read_write> faces_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> sums: array<u32>; // count of digit d in block b: [d * blocks + b]
#if FIRST
@group(0) @binding(6) var<storage, read_write> arguments: array<u32>; // see `write_arguments`
#else
@group(0) @binding(6) var<storage, read> arguments: array<u32>;
#endif

var<workgroup> digits: array<u32, 2048>; // (DIGITS, WORKERS)
var<workgroup> tops: array<u32, 256>;

#if FIRST
fn items() -> u32 { return current.items; }
fn takes_part(key: u32) -> bool { return key < UNLISTED; }
fn face_of(item: u32) -> u32 { return item; }
#else
fn items() -> u32 { return arguments[0]; }
fn takes_part(key: u32) -> bool { return true; }
fn face_of(item: u32) -> u32 { return faces_in[item]; }
#endif

fn digit_of(key: u32) -> u32 { return (key >> current.shift) & current.mask; }

fn count_run(start: u32, end: u32, me: u32) {
    for (var d = 0u; d < DIGITS; d++) {
        digits[d * WORKERS + me] = 0u;
    }
    for (var i = start; i < end; i++) {
        let key = keys_in[i];
        if (takes_part(key)) {
            digits[digit_of(key) * WORKERS + me] += 1u;
        }
    }
}

@compute @workgroup_size(128)
fn count(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) me: u32) {
    let start = group.x * BLOCK + me * RUN;
    count_run(start, min(start + RUN, items()), me);
    workgroupBarrier();
    if (me < DIGITS) {
        var sum = 0u;
        for (var k = 0u; k < WORKERS; k++) {
            sum += digits[me * WORKERS + k];
        }
        sums[me * current.blocks + group.x] = sum;
    }
}

// Runs in a single workgroup.
// Replaces the counts in `sums` by their exclusive prefix sums: the first position of each digit in each block.
// The first step also writes the arguments of the draws.
@compute @workgroup_size(256)
fn scan(@builtin(local_invocation_index) me: u32) {
    let blocks = (items() + BLOCK - 1u) / BLOCK;
    let entries = DIGITS * blocks;
    let share = (entries + 255u) / 256u; // entries per invocation
    let start = min(me * share, entries);
    let end = min(start + share, entries);
    var sum = 0u;
    for (var k = start; k < end; k++) {
        sum += sums[(k / blocks) * current.blocks + k % blocks];
    }
    tops[me] = sum;
    workgroupBarrier();
    for (var reach = 1u; reach < 256u; reach *= 2u) {
        var before = 0u;
        if (me >= reach) {
            before = tops[me - reach];
        }
        workgroupBarrier();
        tops[me] += before;
        workgroupBarrier();
    }
    var running = tops[me] - sum;
    for (var k = start; k < end; k++) {
        let at = (k / blocks) * current.blocks + k % blocks;
        let here = sums[at];
        sums[at] = running;
        running += here;
    }
#if FIRST
    if (me == 255u) {
        write_arguments(tops[255]);
    }
#endif
}

#if FIRST

// Writes the buffer `arguments`.
// Entry 0 is the number of listed faces, entries 1 to 3 are the numbers of workgroups of later sort passes.
// Eight entries follow for each record buffer.
// Three entries are the numbers of workgroups that write the record buffer.
// One entry is the first face of the buffer in sorted order.
// Four entries are the arguments of the indirect draw.
// All chunks have equal sizes, but the last chunks may be smaller.
fn write_arguments(listed: u32) {
    arguments[0] = listed;
    arguments[1] = (listed + BLOCK - 1u) / BLOCK;
    arguments[2] = 1u;
    arguments[3] = 1u;
    let chunk = (listed + current.chunks - 1u) / current.chunks;
    let part = (chunk + current.parts - 1u) / current.parts;
    for (var k = 0u; k < current.chunks * current.parts; k++) {
        let start = k / current.parts * chunk;
        let end = min(start + chunk, listed);
        let first = min(start + k % current.parts * part, end);
        let here = min(end - first, part);
        let at = 4u + 8u * k;
        arguments[at] = (here + 63u) / 64u;
        arguments[at + 1u] = 1u;
        arguments[at + 2u] = 1u;
        arguments[at + 3u] = first;
        arguments[at + 4u] = 4u; // the corners of a quad
        arguments[at + 5u] = here;
        arguments[at + 6u] = 0u;
        arguments[at + 7u] = 0u;
    }
}
#endif

@compute @workgroup_size(128)
fn place(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) me: u32) {
    let start = group.x * BLOCK + me * RUN;
    let end = min(start + RUN, items());
    count_run(start, end, me);
    workgroupBarrier();
    // Exclusive prefix sums of the counts, in the order of digits, then of invocations.
    let row = me * DIGITS;
    var sum = 0u;
    for (var k = 0u; k < DIGITS; k++) {
        sum += digits[row + k];
    }
    tops[me] = sum;
    workgroupBarrier();
    for (var reach = 1u; reach < WORKERS; reach *= 2u) {
        var before = 0u;
        if (me >= reach) {
            before = tops[me - reach];
        }
        workgroupBarrier();
        tops[me] += before;
        workgroupBarrier();
    }
    var running = tops[me] - sum;
    for (var k = 0u; k < DIGITS; k++) {
        let here = digits[row + k];
        digits[row + k] = running;
        running += here;
    }
    workgroupBarrier();
    // The first position of each digit in this block.
    if (me < DIGITS) {
        tops[me] = digits[me * WORKERS];
    }
    workgroupBarrier();
    for (var i = start; i < end; i++) {
        let key = keys_in[i];
        if (!takes_part(key)) {
            continue;
        }
        let d = digit_of(key);
        let at = sums[d * current.blocks + group.x] + digits[d * WORKERS + me] - tops[d];
        digits[d * WORKERS + me] += 1u;
        keys_out[at] = key;
        faces_out[at] = face_of(i);
    }
}
