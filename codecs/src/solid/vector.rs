//! Points and directions in space: + - * / and the square root in a fixed order, the same on every machine.

/// A point or a direction.
pub type Vector = [f64; 3];

pub fn add(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub fn sub(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub fn scaled(a: Vector, s: f64) -> Vector {
    [a[0] * s, a[1] * s, a[2] * s]
}

pub fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub fn length(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

/// The same direction of length 1; zero stays zero.
pub fn unit(a: Vector) -> Vector {
    // By the largest component first: squares of tiny or great numbers do not leave what f64 can hold.
    let most = a[0].abs().max(a[1].abs()).max(a[2].abs());
    if most == 0.0 {
        return [0.0; 3];
    }
    let near = a.map(|v| v / most);
    scaled(near, 1.0 / length(near))
}

/// The angle between two unit vectors, 0 to pi: accurate where they are nearly the same or opposite, too.
pub fn angle(a: Vector, b: Vector) -> f64 {
    let (across, along) = (length(sub(a, b)), length(add(a, b)));
    if across == 0.0 {
        0.0
    } else if across <= along {
        2.0 * arctan(across / along)
    } else {
        std::f64::consts::PI - 2.0 * arctan(along / across)
    }
}

/// The arc tangent of 0 to 1, to 1e-15: halved twice, then its series. The library's own differs from machine to machine.
fn arctan(t: f64) -> f64 {
    let halved = |t: f64| t / (1.0 + (1.0 + t * t).sqrt());
    let t = halved(halved(t));
    let square = t * t;
    let mut sum = 0.0;
    for k in (0..12).rev() {
        sum = 1.0 / (2 * k + 1) as f64 - square * sum;
    }
    4.0 * t * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_those_of_the_library() {
        for k in 0..=1000 {
            let wanted = std::f64::consts::PI * f64::from(k) / 1000.0;
            let found = angle([1.0, 0.0, 0.0], [wanted.cos(), 0.0, wanted.sin()]);
            assert!((found - wanted).abs() < 1e-14, "{wanted}: {found}");
        }
        assert_eq!(angle([0.0; 3], [0.0; 3]), 0.0);
    }

    #[test]
    fn units_of_any_size() {
        for size in [1e-200, 1e-9, 1.0, 1e200] {
            assert!((length(unit([3.0 * size, -4.0 * size, 0.0])) - 1.0).abs() < 1e-15);
        }
        assert_eq!(unit([0.0; 3]), [0.0; 3]);
    }
}
