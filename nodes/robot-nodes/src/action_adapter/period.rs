//! A period with the motion in it.

use crate::displacement::Displacement;

/// A completed period. It becomes one action.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Period {
    pub(super) start_ns: i64,
    pub(super) displacement: Displacement,
}
