//! Wavelets by lifting: CDF 5/3 with whole-point mirror.
