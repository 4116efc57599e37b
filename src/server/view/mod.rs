//! Views: what clients hold, kept in step with moving questions and arriving surveys (`proto/terraquilt/v1/view.proto`).
//!
//! - [`Set`]: what a client holds; [`Target`]: what it should hold; [`Difference`]: what leads from one to the other;
//! - [`Ledger`]: what was sent to one client, and what it may come back with; [`Parcel`]: a difference as messages;
//! - [`Session`]: a view and the stream that has it; [`Sessions`]: all of them;
//! - `stream`: the newest difference whenever there is room for one.

mod difference;
mod ledger;
mod parcel;
mod session;
mod sessions;
mod set;
mod stream;
mod target;

pub use difference::Difference;
pub use ledger::Ledger;
pub use parcel::Parcel;
pub use session::{Attached, Question, Reins, Session, SessionId, Wanted};
pub use sessions::Sessions;
pub use set::{Block, BlockKey, Member, Set};
pub use stream::{Aborted, Incoming, Presented, Reply, feed};
pub use target::{Manner, Target};
