//! What a subscription receives, and who decodes it.

/// Who decodes the messages of a subscription.
#[derive(Clone, Copy)]
pub(super) enum Decoding {
    /// The subscription, so the definition of the type has to be the suite's.
    Here,
    /// The reader of the bytes; any definition will do.
    ByReader,
}

/// The publications that a subscription receives.
#[derive(Clone, Copy)]
pub(super) struct Coverage {
    /// Those of this context.
    pub(super) own: bool,
    /// Latched samples that are older than the subscription.
    pub(super) latched: bool,
    /// Those of best-effort publishers, although the subscription requests reliable.
    pub(super) best_effort: bool,
}

impl Coverage {
    pub(super) const NEW: Self = Self {
        own: true,
        latched: false,
        best_effort: false,
    };
    pub(super) const LATCHED: Self = Self {
        latched: true,
        ..Self::NEW
    };
    pub(super) const ANY: Self = Self {
        best_effort: true,
        ..Self::LATCHED
    };
    pub(super) const OTHERS: Self = Self {
        own: false,
        ..Self::NEW
    };
}
