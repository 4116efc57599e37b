//! One test binary; a module a subject.

mod adaptive;
mod support;
