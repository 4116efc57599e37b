//! Where a question is asked: everything, a box, a polygon.

use crate::base::polygon::Polygon;
use crate::height::lod::cut::Region;
use std::sync::Arc;

/// Where is asked, in the CRS of the database.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Area {
    #[default]
    Everything,
    /// xmin, ymin, xmax, ymax.
    Box([f64; 4]),
    /// The inside of a polygon. Patches are those whose domain meets it; what is made of them is cut along it.
    Polygon(Arc<Polygon>),
}

impl Area {
    /// The box around it; `None`: everything.
    pub fn bounds(&self) -> Option<[f64; 4]> {
        match self {
            Area::Everything => None,
            Area::Box(b) => Some(*b),
            Area::Polygon(p) => Some(p.bounds()),
        }
    }

    /// Whether a point lies in it; borders belong to it.
    pub fn contains(&self, p: [f64; 2]) -> bool {
        match self {
            Area::Everything => true,
            Area::Box(b) => b[0] <= p[0] && p[0] <= b[2] && b[1] <= p[1] && p[1] <= b[3],
            Area::Polygon(polygon) => polygon.contains(p),
        }
    }

    /// A convex region around it; `None`: everything.
    pub(super) fn convex(&self) -> Option<Region> {
        let hull = match self {
            Area::Polygon(p) => Region::hull(p.points().collect()),
            _ => Region::from_box(self.bounds()?),
        };
        // A hull of many corners costs more than it spares.
        let few = hull.polygon.len() <= HULL_CORNERS_MAX;
        Some(if few { hull } else { Region::from_box(self.bounds()?) })
    }
}

/// Corners of a convex region that is worth more than a box.
const HULL_CORNERS_MAX: usize = 32;

impl From<Option<[f64; 4]>> for Area {
    fn from(b: Option<[f64; 4]>) -> Area {
        b.map_or(Area::Everything, Area::Box)
    }
}
