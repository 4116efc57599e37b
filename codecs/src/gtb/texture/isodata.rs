//! ISODATA: classes of feature vectors, as many as the data ask for (specification of GTB, section 6.2). The sender's side alone; sums
//! run in one order, so that the same picture gives the same classes.

/// What bounds the classes.
pub struct Bounds {
    /// Classes to begin with.
    pub begin: usize,
    /// Least and greatest number of classes.
    pub count: [usize; 2],
    /// The least part of all vectors that makes a class.
    pub least: f64,
    /// A class whose deviation along an axis is beyond this is split.
    pub split: f64,
    /// Classes whose centres are closer than this become one.
    pub merge: f64,
    /// Sweeps.
    pub sweeps: usize,
}

impl Default for Bounds {
    fn default() -> Bounds {
        Bounds { begin: 10, count: [5, 16], least: 0.005, split: 1.0, merge: 0.7, sweeps: 8 }
    }
}

/// Classes.
pub struct Classes {
    /// Of each vector its class.
    pub labels: Vec<usize>,
    /// Centres, `axes` numbers each.
    pub centres: Vec<Vec<f64>>,
}

/// Classes of `vectors`, `axes` numbers each.
pub fn classify(vectors: &[f64], axes: usize, bounds: &Bounds) -> Classes {
    let count = vectors.len() / axes;
    let vector = |k: usize| &vectors[k * axes..][..axes];
    // Begin with vectors at even steps of the first axis, which is the brightest.
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|a, b| vectors[a * axes].total_cmp(&vectors[b * axes]).then(a.cmp(b)));
    let begin = bounds.begin.min(count).max(1);
    let mut centres: Vec<Vec<f64>> = (0..begin)
        .map(|k| vector(order[((2 * k + 1) * count / (2 * begin)).min(count - 1)]).to_vec())
        .collect();
    let mut labels = vec![0; count];
    for sweep in 0..bounds.sweeps {
        assign(vectors, axes, &centres, &mut labels);
        let (means, deviations, sizes) = moments(vectors, axes, centres.len(), &labels);
        let least = (bounds.least * count as f64).ceil() as usize;
        let mut kept: Vec<usize> = (0..centres.len()).filter(|k| sizes[*k] >= least.max(1)).collect();
        if kept.is_empty() {
            kept = (0..centres.len()).max_by_key(|k| sizes[*k]).into_iter().collect();
        }
        centres = kept.iter().map(|k| means[*k].clone()).collect();
        if sweep + 1 == bounds.sweeps {
            break;
        }
        let mut split = Vec::new();
        for (place, k) in kept.iter().enumerate() {
            let axis =
                (0..axes).max_by(|a, b| deviations[*k][*a].total_cmp(&deviations[*k][*b])).unwrap_or(0);
            let wide = deviations[*k][axis] > bounds.split && sizes[*k] >= 2 * least.max(1);
            if wide && centres.len() + split.len() < bounds.count[1] {
                let mut other = centres[place].clone();
                other[axis] += deviations[*k][axis] / 2.0;
                centres[place][axis] -= deviations[*k][axis] / 2.0;
                split.push(other);
            }
        }
        centres.append(&mut split);
        merge(&mut centres, bounds);
    }
    assign(vectors, axes, &centres, &mut labels);
    Classes { labels, centres }
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |s, (a, b)| s + (a - b) * (a - b))
}

/// Of each vector the nearest centre; of equals the first.
fn assign(vectors: &[f64], axes: usize, centres: &[Vec<f64>], labels: &mut [usize]) {
    for (label, v) in labels.iter_mut().zip(vectors.chunks_exact(axes)) {
        let mut best = (f64::INFINITY, 0);
        for (k, c) in centres.iter().enumerate() {
            let d = distance(v, c);
            if d < best.0 {
                best = (d, k);
            }
        }
        *label = best.1;
    }
}

/// Means, deviations and sizes of the classes.
fn moments(
    vectors: &[f64],
    axes: usize,
    classes: usize,
    labels: &[usize],
) -> (Vec<Vec<f64>>, Vec<Vec<f64>>, Vec<usize>) {
    let mut sums = vec![vec![0.0; axes]; classes];
    let mut squares = sums.clone();
    let mut sizes = vec![0; classes];
    for (label, v) in labels.iter().zip(vectors.chunks_exact(axes)) {
        sizes[*label] += 1;
        for (axis, v) in v.iter().enumerate() {
            sums[*label][axis] += v;
            squares[*label][axis] += v * v;
        }
    }
    for k in 0..classes {
        let n = sizes[k].max(1) as f64;
        for axis in 0..axes {
            sums[k][axis] /= n;
            squares[k][axis] = (squares[k][axis] / n - sums[k][axis] * sums[k][axis]).max(0.0).sqrt();
        }
    }
    (sums, squares, sizes)
}

/// Makes one of centres that are close, the closest first.
fn merge(centres: &mut Vec<Vec<f64>>, bounds: &Bounds) {
    while centres.len() > bounds.count[0] {
        let mut best = (f64::INFINITY, 0, 0);
        for a in 0..centres.len() {
            for b in a + 1..centres.len() {
                let d = distance(&centres[a], &centres[b]);
                if d < best.0 {
                    best = (d, a, b);
                }
            }
        }
        if best.0.sqrt() >= bounds.merge {
            return;
        }
        let gone = centres.remove(best.2);
        for (v, w) in centres[best.1].iter_mut().zip(gone) {
            *v = (*v + w) / 2.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Heaps far apart are found, whatever the number that it begins with.
    #[test]
    fn heaps_are_classes() {
        let heaps = [[0.0, 0.0], [6.0, 0.0], [0.0, 7.0], [9.0, 9.0], [-8.0, 4.0], [-7.0, -7.0]];
        let vectors: Vec<f64> = (0..3000)
            .flat_map(|k| {
                let h = heaps[k * 7 % 6];
                [h[0] + (k % 13) as f64 * 0.05, h[1] + (k % 11) as f64 * 0.05]
            })
            .collect();
        let found = classify(&vectors, 2, &Bounds::default());
        assert_eq!(found.centres.len(), 6, "{:?}", found.centres);
        for k in 6..3000 {
            assert_eq!(found.labels[k], found.labels[k % 6]);
        }
    }
}
