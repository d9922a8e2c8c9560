/// An unusable bag.
#[derive(Debug)]
pub(super) enum UnusableBag {
    /// It lacks something, and is excluded.
    Lacks(String),
    /// Its robot differs from its description.
    Differs(String),
}

impl UnusableBag {
    /// Changes the text.
    pub fn map(self, words: impl FnOnce(String) -> String) -> Self {
        match self {
            Self::Lacks(what) => Self::Lacks(words(what)),
            Self::Differs(what) => Self::Differs(words(what)),
        }
    }
}
