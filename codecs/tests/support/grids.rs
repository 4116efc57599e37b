//! Real grids: those that come with the repository, and those of the shared data where they are.

use super::shared;
use std::path::Path;
use terraquilt_codecs::gtb::Heights;
use tiff_reader::TiffFile;

/// A grid with a name.
pub struct Grid {
    pub name: String,
    pub heights: Heights,
}

/// Surveys of Mount St. Helens, in units of a tenth of a metre; two have ragged voids.
const BUNDLED: [&str; 4] = [
    "crater_2005-06-15_10m",
    "survey_2000-09-25_native",
    "survey_2004-10-04_native",
    "survey_2004-10-11_native",
];

/// Files of the shared data, the first column and row of a window of at most 513 x 513 posts, and units of a metre.
const SHARED: [(&str, usize, usize, f64); 15] = [
    ("bigtujunga_srtm30m_utm11", 300, 60, 1.0),
    ("colorado_3dep_10m", 128, 0, 10.0),
    ("craterlake_elev_30m", 0, 0, 1.0),
    ("everest_srtm3", 0, 0, 1.0),
    ("gebco_tienshan_15s", 1024, 512, 1.0),
    ("globe_asia_30s", 1024, 2048, 1.0),
    ("jacksboro_fault_3s", 0, 0, 1.0),
    ("minnesota_lidar_dem_1m", 0, 0, 100.0),
    ("nrw_dom1_1m", 256, 256, 100.0),
    ("oso_landslide_lidar_6ft", 256, 256, 10.0),
    ("rainier_srtm3", 512, 512, 1.0),
    ("sanfrancisco_usgs_1s", 0, 0, 10.0),
    ("sierra_srtm3", 1024, 1024, 1.0),
    ("slovenia_lidar_dtm1m", 256, 256, 100.0),
    ("vestfold_32m_polar", 128, 128, 10.0),
];

/// A grid that comes with the repository.
pub fn bundled(name: &str) -> Grid {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/st_helens").join(format!("{name}.tif"));
    read(&path, 0, 0, 10.0)
}

/// All that come with the repository.
pub fn all_bundled() -> Vec<Grid> {
    BUNDLED.into_iter().map(bundled).collect()
}

/// A window of a grid of the shared data.
pub fn of_shared(name: &str) -> Option<Grid> {
    let (_, col, row, units) = *SHARED.iter().find(|(n, ..)| *n == name).expect("a name of the table");
    Some(read(&shared(&format!("dem/{name}.tif"))?, col, row, units))
}

/// All that can be had here.
pub fn all() -> Vec<Grid> {
    let mut out = all_bundled();
    out.extend(SHARED.iter().filter_map(|(name, ..)| of_shared(name)));
    out
}

fn read(path: &Path, col: usize, row: usize, units: f64) -> Grid {
    let name = path.display();
    let tiff = TiffFile::open(path).unwrap_or_else(|e| panic!("{name}: {e}"));
    let (values, shape): (Vec<f64>, Vec<usize>) = match tiff.read_image::<i16>(0) {
        Ok(v) => (v.iter().map(|v| f64::from(*v)).collect(), v.shape().to_vec()),
        Err(_) => {
            let v = tiff.read_image::<f32>(0).unwrap_or_else(|e| panic!("{name}: {e}"));
            (v.iter().map(|v| f64::from(*v)).collect(), v.shape().to_vec())
        }
    };
    let (height, width) = (shape[0], shape[1]);
    let (cols, rows) = ((width - col).min(513), (height - row).min(513));
    let mut heights = Heights { cols, rows, z: Vec::new(), void: Vec::new() };
    for y in row..row + rows {
        for v in &values[y * width + col..][..cols] {
            // What these files write where there is no data.
            let void = !(-9000.0..32_767.0).contains(v);
            heights.void.push(void);
            heights.z.push(if void { 0 } else { (v * units).round() as i32 });
        }
    }
    if !heights.void.contains(&true) {
        heights.void.clear();
    }
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Grid { name, heights }
}

impl Grid {
    /// A rectangle of it.
    pub fn cut(&self, col: usize, row: usize, cols: usize, rows: usize) -> Heights {
        let h = &self.heights;
        let at = |k: usize| (row + k / cols) * h.cols + col + k % cols;
        Heights {
            cols,
            rows,
            z: (0..cols * rows).map(|k| h.z[at(k)]).collect(),
            void: if h.void.is_empty() {
                Vec::new()
            } else {
                (0..cols * rows).map(|k| h.void[at(k)]).collect()
            },
        }
    }
}
