//! One test binary; a module a subject.

mod adaptive;
mod bitree;
mod damage;
mod detail;
mod fractal;
mod frame;
mod given;
mod golden;
mod hostile;
mod layers;
mod prefixes;
mod smallest;
mod solid;
mod sparse;
mod support;
mod texture;
mod voids;
