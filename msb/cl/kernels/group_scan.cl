// Prefix sum over a work-group of GROUP work-items (a power of two) by steps of doubling distance.
// Source: Hillis and Steele, Data parallel algorithms, 1986.

// Returns the sum of `value` over the preceding work-items.
// *total is the sum over all work-items of the group.
// Every work-item of the group must call this function.
// `shared` has GROUP elements and may be reused afterwards.
SUM group_scan(SUM value, __local SUM *shared, SUM *total)
{
    uint me = get_local_id(0);
    SUM sum = value;
    shared[me] = sum;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint distance = 1; distance < GROUP; distance *= 2) {
        SUM before = me >= distance ? shared[me - distance] : 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        sum += before;
        shared[me] = sum;
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    *total = shared[GROUP - 1];
    barrier(CLK_LOCAL_MEM_FENCE);
    return sum - value;
}
