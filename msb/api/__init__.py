"""Public functions that `msb` exports: audit, open, validate and the demo data. Each public function is in
a module of this name."""
