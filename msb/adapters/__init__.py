"""Adapters turn what the methods' training writes into assets; none of them needs torch."""
