//! One test binary; a module a subject.

mod bitree;
mod damage;
mod frame;
mod given;
mod layers;
mod prefixes;
mod support;
mod voids;
