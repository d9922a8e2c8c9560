//! What a frame contributes to later ones.

use std::sync::Arc;

use super::kept::Kept;

/// One frame as the temporal attention of later frames sees it: its keys and values in every block.
#[derive(Clone, Debug)]
pub(crate) struct FrameContext {
    pub(super) kept: Arc<Kept>,
    /// Which of the frames that were computed together.
    pub(super) index: usize,
}

impl FrameContext {
    /// Number of candidates that it was computed for.
    pub(crate) fn batch(&self) -> usize {
        self.kept.batch
    }
}
