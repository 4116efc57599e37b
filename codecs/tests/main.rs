//! One test binary; a module a subject.

mod adaptive;
mod bitree;
mod smallest;
mod sparse;
mod support;
