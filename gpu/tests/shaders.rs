use naga::valid::{Capabilities, ValidationFlags, Validator};
use terraquilt_gpu::shader;

/// Without any capability beyond WebGPU's own.
fn entry_points(text: &str) -> Vec<String> {
    let module = naga::front::wgsl::parse_str(text).unwrap_or_else(|e| panic!("{}", e.emit_to_string(text)));
    let checked = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module);
    checked.unwrap_or_else(|e| panic!("{}", e.emit_to_string(text)));
    module.entry_points.into_iter().map(|e| e.name).collect()
}

#[test]
fn both_forms_are_valid_and_share_the_walk() {
    assert_eq!(entry_points(&shader::compute()), ["decode"]);
    assert_eq!(entry_points(&shader::fragment()), ["cover", "shade"]);
    let walk = include_str!("../src/walk.wgsl");
    assert!(shader::compute().starts_with(walk) && shader::fragment().starts_with(walk));
}
