//! Must show 1: any order of arrival, removal and return gives one fingerprint, computed by a new process.
