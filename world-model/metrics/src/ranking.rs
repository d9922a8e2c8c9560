//! Order of models by one or several raters (the paper, appendix C.1 B).

mod consensus;
mod ranks;

pub use consensus::{SUCCESS_THRESHOLD, consensus, consensus_rate};
pub(crate) use ranks::average_ranks;
pub use ranks::{Ties, borda, ranks};
