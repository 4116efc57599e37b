//! What files are, before a sample of them is read: their system, their lattice, the declaration of their survey.

use super::change::Ingest;
use super::database::Db;
use super::head::{Declaration, Delivered, Resampled};
use super::triangles::metres_per_unit;
use super::view::{Tables, View};
use crate::base::round::significant;
use crate::base::{Error, Result, limits};
use crate::height::crs::{AxisUnit, Crs, DatumChoice, Transform};
use crate::height::frame::Lattice;
use crate::height::source::{Affine, SampleType, SourceInfo};

/// Digits of the spacing that a resampled survey gets.
const STEP_DIGITS: usize = 3;

/// The system of a file: what the user says, else what it says.
pub fn crs_of(info: &SourceInfo, request: &Ingest, db: &Db) -> Result<Crs> {
    if info.affine.is_none() {
        return Err(Error::invalid(
            &info.file,
            "has no georeference: where its posts lie is unknown; write one with gdal_translate -a_ullr ... -a_srs EPSG:n",
        ));
    }
    if info.cols < 4 || info.rows < 4 {
        return Err(Error::invalid(
            &info.file,
            format!("{} x {} posts; at least 4 x 4 are needed", info.cols, info.rows),
        ));
    }
    request.crs.clone().or_else(|| info.crs.clone()).ok_or_else(|| {
        Error::invalid(
            &info.file,
            format!(
                "does not say its coordinate system; say it with --crs (if it is that of the database: --crs {}){}",
                db.crs().code,
                info.notes.iter().map(|n| format!("; {n}")).collect::<String>()
            ),
        )
    })
}

/// The samples of a file as heights in metres: the user's unit, else the file's, else metres.
pub fn samples_of(info: &SourceInfo, request: &Ingest) -> Delivered {
    let metres = request.vertical_unit_m.or(info.vertical_unit_m).unwrap_or(1.0);
    Delivered { sample_type: info.sample_type, scale: info.scale * metres, offset: info.offset * metres }
}

/// What the heights of a file count from. Databases of format 1 have no place for it: there only what the user says counts.
fn datum_of(info: &SourceInfo, request: &Ingest, db: &Db) -> Option<String> {
    let told = info.vertical_datum.clone().filter(|_| db.format() >= 2);
    request.vertical_datum.clone().or(told)
}

/// The one vertical datum that files state.
fn vertical_datum(infos: &[&SourceInfo], request: &Ingest, db: &Db) -> Result<Option<String>> {
    let mut found: Option<(&str, String)> = None;
    for info in infos {
        let Some(datum) = datum_of(info, request, db) else { continue };
        match &found {
            Some((file, other)) if *other != datum => {
                return Err(Error::invalid(
                    &info.file,
                    format!(
                        "its heights count from {datum}, those of {file} from {other}: they are no tiles of one survey"
                    ),
                ));
            }
            _ => found = Some((&info.file, datum)),
        }
    }
    Ok(found.map(|(_, datum)| datum))
}

/// Whether a file needs no resampling: it is in the database's system, or in one whose coordinates are the same numbers
/// everywhere in it (NAD83 and WGS 84, taken as one datum).
fn is_here(crs: &Crs, info: &SourceInfo, request: &Ingest, db: &Db) -> Result<bool> {
    if crs.same_as(db.crs()) {
        return Ok(true);
    }
    if crs.unit != db.crs().unit || request.datum != DatumChoice::None {
        return Ok(false);
    }
    let Ok(way) = Transform::new(crs, db.crs(), &DatumChoice::None) else { return Ok(false) };
    let a = affine_of(info)?;
    let [sx, sy] = Lattice::of_affine(&a)?.nominal_steps();
    let (n, m) = ((info.cols - 1) as f64, (info.rows - 1) as f64);
    let at = |s: f64, t: f64| [0, 1].map(|k| a.origin[k] + s * n * a.col_step[k] + t * m * a.row_step[k]);
    let same = |p: [f64; 2]| {
        let q = way.forward(p);
        q.is_some_and(|q| (0..2).all(|k| (q[k] - p[k]).abs() <= NOWHERE * sx.min(sy)))
    };
    Ok([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.5, 0.5)].into_iter().all(|(s, t)| same(at(s, t))))
}

/// A move of less than so many steps is none.
const NOWHERE: f64 = 1e-4;

/// The declaration of a new survey.
pub fn declare(
    db: &Db,
    infos: &[&SourceInfo],
    request: &Ingest,
    warnings: &mut Vec<String>,
) -> Result<Declaration> {
    let first = infos[0];
    let crs = crs_of(first, request, db)?;
    let delivered = declared_lattice(&Lattice::of_affine(&affine_of(first)?)?, request)?;
    let samples = samples_of(first, request);
    let vertical_datum = vertical_datum(infos, request, db)?;
    let accuracy_m = accuracy(first, request, warnings)?;
    let name = name(first, request)?;
    let here = db.crs();
    if let (Some(said), Some(told)) = (&request.crs, &first.crs)
        && !said.same_as(told)
    {
        warnings.push(format!("{}: the file says {}, it is taken as {}", first.file, told.code, said.code));
    }
    warnings.extend(stretched(&crs, infos, db)?);
    let (lattice, resampled) = if is_here(&crs, first, request, db)? {
        if crs.code != here.code {
            warnings.push(format!(
                "{} is in {}, whose coordinates are those of the database's {}: nothing is resampled",
                first.file, crs.code, here.code
            ));
        }
        for (given, option) in
            [(request.step.is_some(), "--step"), (request.datum != DatumChoice::None, "--datum-shift")]
        {
            if given {
                warnings.push(format!("{}: {option} has no effect, nothing is resampled", first.file));
            }
        }
        (delivered, None)
    } else {
        let centre = centre(infos)?;
        // A choice that is not needed is not recorded: the same file is the same survey with it and without.
        let datum = match Transform::new(&crs, here, &DatumChoice::None) {
            Ok(_) => DatumChoice::None,
            Err(_) => request.datum.clone(),
        };
        if datum != request.datum {
            warnings.push(format!("{}: --datum-shift has no effect, the systems say how to go", first.file));
        }
        let transform = Transform::new(&crs, here, &datum)?;
        warnings.extend(transform.notes().iter().map(|n| format!("{}: {n}", first.file)));
        let lattice = own_lattice(&delivered, centre, &transform, db, request, &first.file)?;
        let [sx, sy] = lattice.nominal_steps();
        warnings.push(format!(
            "{} is in {}, the database in {}: its posts are resampled at {sx} x {sy}; the delivered samples are kept, too",
            first.file, crs.code, here.code
        ));
        let resampled = Resampled {
            crs: crs.code.clone(),
            lattice: delivered,
            samples,
            turn: turn(infos, &crs)?,
            datum: datum.to_string(),
            operation: transform.description().to_string(),
        };
        (lattice, Some(resampled))
    };
    if db.format() < 2 && (resampled.is_some() || vertical_datum.is_some()) {
        let what = if resampled.is_some() { "in another system" } else { "with a vertical datum" };
        return Err(Error::unsupported(
            &first.file,
            format!(
                "a survey {what} needs database format 2, {} is of format {}",
                db.path().display(),
                db.format()
            ),
            "make a new database with `terraquilt init` and ingest what `export --survey` gives back of the old one",
        ));
    }
    let own = match &resampled {
        None => samples,
        Some(_) => Delivered { sample_type: SampleType::F32, scale: 1.0, offset: 0.0 },
    };
    Ok(Declaration {
        name,
        crs: here.code.clone(),
        lattice,
        frame: lattice.frame(db.unit())?,
        sample_type: own.sample_type,
        scale: own.scale,
        offset: own.offset,
        accuracy_m,
        vertical_datum,
        resampled,
    })
}

fn affine_of(info: &SourceInfo) -> Result<Affine> {
    info.affine.ok_or_else(|| Error::invalid(&info.file, "has no georeference"))
}

/// Where longitudes are counted from: half a turn to either side of it. For files in degrees 0, or, across the antimeridian, a
/// turn that holds them; for others the multiple of 90 next to the middle of their system, whichever file comes first.
fn turn(infos: &[&SourceInfo], crs: &Crs) -> Result<f64> {
    if crs.unit != AxisUnit::Degree {
        return Ok((crs.middle()?[0] / 90.0).round() * 90.0);
    }
    let [x0, _, x1, _] = extent(infos)?;
    Ok(match (x0 < -180.0, x1 > 180.0) {
        (_, true) => 180.0,
        (true, _) => -180.0,
        _ => 0.0,
    })
}

/// A note where lengths on the database's map are not those on the ground: far from what its system is made for, or in one that is
/// made for no place (web Mercator).
fn stretched(crs: &Crs, infos: &[&SourceInfo], db: &Db) -> Result<Option<String>> {
    const NOTED: f64 = 0.01;
    let AxisUnit::Metre(unit_m) = db.crs().unit else { return Ok(None) };
    let globe = Crs::from_epsg(4326)?;
    let (Ok(there), Ok(here)) = (
        Transform::new(crs, &globe, &DatumChoice::Ballpark),
        Transform::new(&globe, db.crs(), &DatumChoice::Ballpark),
    ) else {
        return Ok(None);
    };
    let Some(c) = there.forward(centre(infos)?) else { return Ok(None) };
    const STEP: f64 = 1e-4;
    let at = |dx: f64, dy: f64| here.forward([c[0] + dx, c[1] + dy]);
    let (Some(w), Some(e), Some(s), Some(n)) = (at(-STEP, 0.0), at(STEP, 0.0), at(0.0, -STEP), at(0.0, STEP))
    else {
        return Ok(None);
    };
    let area = ((e[0] - w[0]) * (n[1] - s[1]) - (e[1] - w[1]) * (n[0] - s[0])).abs() * unit_m * unit_m;
    let ground = metres_per_unit(AxisUnit::Degree, c);
    let scale = (area / (4.0 * STEP * STEP * ground[0] * ground[1])).sqrt();
    Ok(((scale - 1.0).abs() > NOTED).then(|| {
        format!(
            "at {:.3}, {:.3} (longitude, latitude) lengths in {} are {scale:.3} times those on the ground: areas, slopes and volumes there \
             are those of the map",
            c[0],
            c[1],
            db.crs().code
        )
    }))
}

/// The lattice of the files, as the user declares it.
fn declared_lattice(found: &Lattice, request: &Ingest) -> Result<Lattice> {
    let mut lattice = *found;
    if let Some([sx, sy, px, py]) = request.lattice {
        let [nx, ny] = lattice.nominal_steps();
        if !(sx > 0.0 && sy > 0.0 && px.is_finite() && py.is_finite()) {
            return Err(Error::invalid("--lattice", format!("steps {sx}, {sy} must be positive")));
        }
        lattice.col_step = lattice.col_step.map(|s| significant(s / nx * sx, 12));
        lattice.row_step = lattice.row_step.map(|s| significant(s / ny * sy, 12));
        lattice.phase = [px.rem_euclid(1.0), py.rem_euclid(1.0)];
    }
    Ok(lattice)
}

/// Middle of the box around all files, in their system.
fn centre(infos: &[&SourceInfo]) -> Result<[f64; 2]> {
    let b = extent(infos)?;
    Ok([(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0])
}

/// The box around all posts of files: xmin, ymin, xmax, ymax.
fn extent(infos: &[&SourceInfo]) -> Result<[f64; 4]> {
    let mut b = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for info in infos {
        let a = affine_of(info)?;
        let (n, m) = ((info.cols - 1) as f64, (info.rows - 1) as f64);
        for (c, r) in [(0.0, 0.0), (n, 0.0), (0.0, m), (n, m)] {
            let p = [0, 1].map(|k| a.origin[k] + c * a.col_step[k] + r * a.row_step[k]);
            b = [b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])];
        }
    }
    Ok(b)
}

/// North-up posts in the database's system: as many to the area as the files have at the declared centre, at multiples of
/// the spacing from the origin of the system.
fn own_lattice(
    delivered: &Lattice,
    centre: [f64; 2],
    transform: &Transform,
    db: &Db,
    request: &Ingest,
    file: &str,
) -> Result<Lattice> {
    let steps = match request.step {
        Some(s) => s,
        None => {
            let at = |p: [f64; 2]| {
                transform.forward(p).ok_or_else(|| {
                    Error::invalid(
                        file,
                        format!(
                            "its centre {}, {} has no place in the database's CRS ({}); make a database in a CRS that suits it",
                            p[0],
                            p[1],
                            transform.description()
                        ),
                    )
                })
            };
            // One step of the files to either side of the centre.
            let vector = |s: [f64; 2]| -> Result<[f64; 2]> {
                let (a, b) = (
                    at([centre[0] - s[0] / 2.0, centre[1] - s[1] / 2.0])?,
                    at([centre[0] + s[0] / 2.0, centre[1] + s[1] / 2.0])?,
                );
                Ok([b[0] - a[0], b[1] - a[1]])
            };
            let (u, v) = (vector(delivered.col_step)?, vector(delivered.row_step)?);
            let metres = metres_per_unit(db.crs().unit, at(centre)?);
            let side = ((u[0] * v[1] - u[1] * v[0]).abs() * metres[0] * metres[1]).sqrt();
            metres.map(|m| significant(side / m, STEP_DIGITS))
        }
    };
    if !steps.iter().all(|s| s.is_finite() && *s > 0.0) {
        let reason = match request.step {
            Some(_) => format!("{steps:?}: steps are positive numbers"),
            None => format!("{file} has no spacing at its centre in the database's CRS; say one"),
        };
        return Err(Error::invalid("--step", reason));
    }
    Ok(Lattice { col_step: [steps[0], 0.0], row_step: [0.0, steps[1]], phase: [0.0; 2] })
}

fn accuracy(first: &SourceInfo, request: &Ingest, warnings: &mut Vec<String>) -> Result<f64> {
    let accuracy_m = match (request.accuracy_m, first.accuracy_m) {
        (Some(a), _) => a,
        (None, Some(a)) => {
            let product = first.product.unwrap_or("product");
            warnings.push(format!(
                "{}: accuracy {a} m, that of {product}; --accuracy says otherwise",
                first.file
            ));
            a
        }
        (None, None) => {
            return Err(Error::invalid(
                "accuracy",
                format!(
                    "{} does not say how accurate its heights are; give --accuracy METRES (the largest error you trust it not to exceed)",
                    first.file
                ),
            ));
        }
    };
    if !(0.0..=1e6).contains(&accuracy_m) {
        return Err(Error::invalid(
            "--accuracy",
            format!("{accuracy_m} m; it must be between 0 and 1000000"),
        ));
    }
    Ok(accuracy_m)
}

fn name(first: &SourceInfo, request: &Ingest) -> Result<String> {
    let name = request.name.clone().unwrap_or_else(|| {
        std::path::Path::new(&first.file)
            .file_stem()
            .map_or_else(|| first.file.clone(), |s| s.to_string_lossy().into_owned())
    });
    if name.is_empty() || name.len() > limits::TEXT_BYTES_MAX / 4 {
        return Err(Error::invalid(
            "--name",
            format!("'{name}': a name has 1 to {} bytes", limits::TEXT_BYTES_MAX / 4),
        ));
    }
    if name.chars().any(char::is_control) {
        // It is printed on terminals, whoever sent it.
        return Err(Error::invalid("--name", format!("{name:?} holds control characters; leave them out")));
    }
    Ok(name)
}

/// Whether what the user says of new tiles agrees with the survey that they join.
pub fn agree(d: &Declaration, first: &SourceInfo, request: &Ingest) -> Result<()> {
    if let Some(a) = request.accuracy_m
        && a != d.accuracy_m
    {
        return Err(Error::invalid(
            "--accuracy",
            format!(
                "{a} m, survey '{}' declares {} m; a declaration never changes: leave it out, or ingest {} as a survey of its own",
                d.name, d.accuracy_m, first.file
            ),
        ));
    }
    let declared = d.resampled.as_ref().map_or("none", |r| &r.datum);
    if request.datum != DatumChoice::None && request.datum.to_string() != declared {
        return Err(Error::invalid(
            "--datum-shift",
            format!("'{}', survey '{}' declares '{declared}'; leave it out", request.datum, d.name),
        ));
    }
    if request.step.is_some() {
        return Err(Error::invalid(
            "--step",
            format!("survey '{}' has its lattice already; leave it out", d.name),
        ));
    }
    Ok(())
}

/// Whether a file can be a tile of a survey: same system, same kind of samples, same vertical datum.
pub fn fits(d: &Declaration, info: &SourceInfo, request: &Ingest, db: &Db) -> Result<()> {
    let (crs, declared) = (crs_of(info, request, db)?, Crs::parse(d.delivered_crs())?);
    let same = crs.same_as(&declared) || d.resampled.is_none() && is_here(&crs, info, request, db)?;
    if !same {
        return Err(Error::invalid(
            &info.file,
            format!(
                "is in {}, survey '{}' was delivered in {}; ingest it as a survey of its own",
                crs.code, d.name, declared.code
            ),
        ));
    }
    let (found, have) = (samples_of(info, request), d.delivered());
    if found != have {
        return Err(Error::invalid(
            &info.file,
            format!(
                "samples are {} (scale {}, offset {}), the survey's are {} (scale {}, offset {}); ingest it as a survey of its own",
                found.sample_type.name(),
                found.scale,
                found.offset,
                have.sample_type.name(),
                have.scale,
                have.offset
            ),
        ));
    }
    let Some(datum) = datum_of(info, request, db) else { return Ok(()) };
    let have = match &d.vertical_datum {
        Some(b) if *b == datum => return Ok(()),
        Some(b) => format!("from {b}"),
        None => "from a datum that nobody stated".into(),
    };
    let reason = format!(
        "its heights count from {datum}, those of survey '{}' {have}; ingest it as a survey of its own",
        d.name
    );
    Err(Error::invalid(&info.file, reason))
}

/// Refuses to mix heights that are known to count from different surfaces.
pub fn one_vertical_datum(d: &Declaration, view: &View) -> Result<()> {
    let Some(own) = &d.vertical_datum else { return Ok(()) };
    for n in view.entries().keys() {
        let other = &view.head(*n)?.declaration;
        if let Some(o) = other.vertical_datum.as_ref().filter(|o| *o != own) {
            return Err(Error::invalid(
                &d.name,
                format!(
                    "its heights count from {own}, those of survey '{}' from {o}: they would be metres apart for no reason on \
                     the ground. convert it (--geoid turns heights above a geoid into ellipsoidal ones), or say what is true \
                     with --vertical-datum",
                    other.name
                ),
            ));
        }
    }
    Ok(())
}
