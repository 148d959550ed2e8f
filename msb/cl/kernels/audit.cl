// The audit of a mesh's structure, for a CPU: what msb/topology/kernel.py launches, in this order.
//
//   count_corners    how many corners fall into each block of vertices
//   place_corners    each corner, with the rest of its face, to its block     } for each round of blocks
//   visit_blocks     edges, fans and duplicates, vertex by vertex             }
//   unite_pairs      components, from the pairs of faces that the visits found
//   measure_faces    areas, and the faces of each component
//   sum_largest      the largest component
//
// Everything is counted in integers and everything listed is ordered by number, so results do not depend on how many
// work-items there are or which takes which part. Areas are added in the order in which NumPy adds them.

#include "lanes.cl"
#include "audit_types.cl"
#include "audit_partition.cl"
#include "audit_pairs.cl"
#include "audit_small.cl"
#include "audit_large.cl"
#include "audit_blocks.cl"
#include "audit_faces.cl"
