//! One test binary; a module a subject.

mod bitree;
mod support;
