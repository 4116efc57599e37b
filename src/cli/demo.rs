//! `demo`: stub
use crate::base::Result;
use clap::Args;
/// The whole story on bundled real surveys
#[derive(Args)]
pub struct Demo {}
impl Demo { pub fn run(self) -> Result<bool> { Ok(true) } }
