//! One test binary; a module a subject.

mod adaptive;
mod bitree;
mod sparse;
mod support;
