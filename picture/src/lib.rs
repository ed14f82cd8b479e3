//! A map made visible: raster, PNG and SVG, terminal cells.
