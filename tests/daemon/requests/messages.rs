//! Any valid message of a method's request, made of bytes: every field may be there or not, numbers are often the odd ones,
//! and some are sensible, so that what lies behind the checks is reached, too.

use arbitrary::Unstructured;
use prost_reflect::prost::Message;
use prost_reflect::{
    Cardinality, DescriptorPool, DynamicMessage, FieldDescriptor, Kind, MapKey, MessageDescriptor, Value,
};
use std::sync::OnceLock;

/// What a sensible request may speak of.
pub struct Facts<'a> {
    pub names: &'a [String],
    pub bounds: [f64; 4],
}

fn pool() -> &'static DescriptorPool {
    static POOL: OnceLock<DescriptorPool> = OnceLock::new();
    POOL.get_or_init(|| DescriptorPool::decode(terraquilt::wire::DESCRIPTORS).expect("made by the build"))
}

/// Every method, as `/package.Service/Method`.
pub fn methods() -> Vec<String> {
    let of = |s: prost_reflect::ServiceDescriptor| {
        s.methods().map(|m| format!("/{}/{}", s.full_name(), m.name())).collect::<Vec<_>>()
    };
    pool().services().flat_map(of).collect()
}

/// A message for a method.
pub fn message(method: &str, facts: &Facts, u: &mut Unstructured) -> arbitrary::Result<Vec<u8>> {
    let (service, name) = method.trim_start_matches('/').split_once('/').expect("a path of a method");
    let service = pool().get_service_by_name(service).expect("a service of the descriptors");
    let m = service.methods().find(|m| m.name() == name).expect("a method of the service");
    Ok(fill(m.input(), facts, u, 0)?.encode_to_vec())
}

fn fill(
    of: MessageDescriptor,
    facts: &Facts,
    u: &mut Unstructured,
    depth: usize,
) -> arbitrary::Result<DynamicMessage> {
    let mut out = DynamicMessage::new(of.clone());
    for field in of.fields() {
        // Deep messages end; a field is there three times of four.
        if depth > 6 || u.ratio(1, 4)? {
            continue;
        }
        let value = if field.is_map() {
            Value::Map(std::collections::HashMap::<MapKey, Value>::new())
        } else if field.cardinality() == Cardinality::Repeated {
            let n = u.int_in_range(0..=3)?;
            Value::List((0..n).map(|_| one(&field, facts, u, depth)).collect::<arbitrary::Result<_>>()?)
        } else {
            one(&field, facts, u, depth)?
        };
        out.set_field(&field, value);
    }
    Ok(out)
}

fn one(
    field: &FieldDescriptor,
    facts: &Facts,
    u: &mut Unstructured,
    depth: usize,
) -> arbitrary::Result<Value> {
    Ok(match field.kind() {
        Kind::Double => Value::F64(number(field.name(), facts, u)?),
        Kind::Float => Value::F32(number(field.name(), facts, u)? as f32),
        Kind::Int32 | Kind::Sint32 | Kind::Sfixed32 => Value::I32(whole(u)? as i32),
        Kind::Int64 | Kind::Sint64 | Kind::Sfixed64 => Value::I64(whole(u)?),
        Kind::Uint32 | Kind::Fixed32 => Value::U32(whole(u)? as u32),
        Kind::Uint64 | Kind::Fixed64 => Value::U64(whole(u)? as u64),
        Kind::Bool => Value::Bool(u.arbitrary()?),
        Kind::String => Value::String(text(facts, u)?),
        Kind::Bytes => Value::Bytes(packed(facts, u)?.into()),
        Kind::Enum(e) => {
            let known = e.values().count() as i32;
            Value::EnumNumber(if u.ratio(1, 8)? { u.arbitrary()? } else { u.int_in_range(0..=known)? })
        }
        Kind::Message(m) => Value::Message(fill(m, facts, u, depth + 1)?),
    })
}

fn number(name: &str, facts: &Facts, u: &mut Unstructured) -> arbitrary::Result<f64> {
    const ODD: [f64; 12] = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::MAX,
        f64::MIN_POSITIVE,
        1e-300,
        1e18,
        180.0,
    ];
    if u.ratio(1, 6)? {
        return Ok(*u.choose(&ODD)?);
    }
    let t = f64::from(u.int_in_range(0..=1000u16)?) / 1000.0;
    let b = facts.bounds;
    let axis = usize::from(name.contains('y') && !name.contains("accuracy"));
    Ok(match name {
        _ if name.ends_with("_z") => 1500.0 + 2000.0 * t,
        _ if name.contains('x') && !name.contains("pixels")
            || name.ends_with('y')
            || name.ends_with("_y") =>
        {
            let reach = b[axis + 2] - b[axis];
            if name.contains("max") { b[axis + 2] - t * reach / 2.0 } else { b[axis] + t * reach / 2.0 }
        }
        "fov_deg" => 1.0 + 178.0 * t,
        _ => t * 10.0,
    })
}

fn whole(u: &mut Unstructured) -> arbitrary::Result<i64> {
    const ODD: [i64; 8] = [0, 1, -1, i64::MAX, i64::MIN, i32::MAX as i64, 1 << 40, u32::MAX as i64];
    if u.ratio(1, 4)? { Ok(*u.choose(&ODD)?) } else { Ok(i64::from(u.int_in_range(0..=64u8)?)) }
}

fn text(facts: &Facts, u: &mut Unstructured) -> arbitrary::Result<String> {
    const ODD: [&str; 10] = [
        "",
        "..",
        "/etc/passwd",
        "EPSG:26910",
        "EPSG:4326",
        "2004-10-12",
        "a,b",
        "\0",
        "{}",
        "+proj=utm +zone=10",
    ];
    Ok(match u.int_in_range(0..=3u8)? {
        0 => u.choose(&ODD)?.to_string(),
        1 => facts.names.get(u.int_in_range(0..=facts.names.len().max(1) - 1)?).cloned().unwrap_or_default(),
        2 => "x".repeat(u.int_in_range(0..=5000usize)?),
        _ => u.arbitrary::<&str>()?.to_string(),
    })
}

/// Bytes that are often points.
fn packed(facts: &Facts, u: &mut Unstructured) -> arbitrary::Result<Vec<u8>> {
    if u.ratio(1, 3)? {
        let n = u.int_in_range(0..=40usize)?;
        return Ok(u.bytes(n.min(u.len()))?.to_vec());
    }
    let n = u.int_in_range(0..=8)?;
    let mut out = Vec::new();
    for _ in 0..n {
        for name in ["x", "y"] {
            out.extend_from_slice(&number(name, facts, u)?.to_le_bytes());
        }
    }
    Ok(out)
}
