//! Units of length by their EPSG codes.

use super::vertical::{FOOT_M, US_FOOT_M};

/// Code and metres. Source: EPSG v11.022 as in PROJ 9.5.1, all its units of length.
#[rustfmt::skip]
const LENGTHS: [(u16, f64); 55] = [
    (1025, 0.001), // millimetre
    (1033, 0.01), // centimetre
    (9001, 1.0), // metre
    (9002, FOOT_M), // foot
    (9003, US_FOOT_M), // US survey foot
    (9005, 0.3047972654), // Clarke's foot
    (9014, 1.8288), // fathom
    (9030, 1852.0), // nautical mile
    (9031, 1.0000135965), // German legal metre
    (9033, 20.11684023368047), // US survey chain
    (9034, 0.2011684023368047), // US survey link
    (9035, 1609.3472186944375), // US survey mile
    (9036, 1000.0), // kilometre
    (9037, 0.9143917962), // Clarke's yard
    (9038, 20.1166195164), // Clarke's chain
    (9039, 0.201166195164), // Clarke's link
    (9040, 0.9143984146160287), // British yard (Sears 1922)
    (9041, 0.3047994715386762), // British foot (Sears 1922)
    (9042, 20.116765121552632), // British chain (Sears 1922)
    (9043, 0.2011676512155263), // British link (Sears 1922)
    (9050, 0.9143992), // British yard (Benoit 1895 A)
    (9051, 0.3047997333333333), // British foot (Benoit 1895 A)
    (9052, 20.1167824), // British chain (Benoit 1895 A)
    (9053, 0.201167824), // British link (Benoit 1895 A)
    (9060, 0.9143992042898124), // British yard (Benoit 1895 B)
    (9061, 0.30479973476327077), // British foot (Benoit 1895 B)
    (9062, 20.116782494375872), // British chain (Benoit 1895 B)
    (9063, 0.2011678249437587), // British link (Benoit 1895 B)
    (9070, 0.30480083333333335), // British foot (1865)
    (9080, 0.30479951024814694), // Indian foot
    (9081, 0.30479841), // Indian foot (1937)
    (9082, 0.3047996), // Indian foot (1962)
    (9083, 0.3047995), // Indian foot (1975)
    (9084, 0.9143985307444408), // Indian yard
    (9085, 0.91439523), // Indian yard (1937)
    (9086, 0.9143988), // Indian yard (1962)
    (9087, 0.9143985), // Indian yard (1975)
    (9093, 1609.344), // Statute mile
    (9094, 0.3047997101815088), // Gold Coast foot
    (9095, 0.3048007491), // British foot (1936)
    (9096, 0.9144), // yard
    (9097, 20.1168), // chain
    (9098, 0.201168), // link
    (9099, 0.914398), // British yard (Sears 1922 truncated)
    (9204, 100.58420116840234), // Bin width 330 US survey feet
    (9205, 50.29210058420117), // Bin width 165 US survey feet
    (9206, 25.146050292100586), // Bin width 82.5 US survey feet
    (9207, 37.5), // Bin width 37.5 metres
    (9208, 25.0), // Bin width 25 metres
    (9209, 12.5), // Bin width 12.5 metres
    (9210, 6.25), // Bin width 6.25 metres
    (9211, 3.125), // Bin width 3.125 metres
    (9300, 0.30479933333333337), // British foot (Sears 1922 truncated)
    (9301, 20.116756), // British chain (Sears 1922 truncated)
    (9302, 0.20116756), // British link (Sears 1922 truncated)
];

/// Metres of a unit of length; None for codes that are no such unit.
pub fn metres_of_code(code: u16) -> Option<f64> {
    LENGTHS.iter().find(|(c, _)| *c == code).map(|(_, metres)| *metres)
}
