use crate::judges::{
    record::Outcome,
    verdict::{self, VerdictError},
};

/// Form of the requested answer.
#[derive(Clone, Copy, Debug)]
pub(super) enum Form {
    Success { partial: bool },
    Rubric,
}

impl Form {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Success { partial: false } => "success",
            Self::Success { partial: true } => "partial_success",
            Self::Rubric => "rubric",
        }
    }

    pub(super) fn parse(self, answer: &str) -> std::result::Result<Outcome, VerdictError> {
        match self {
            Self::Success { partial } => {
                verdict::parse_success(answer, partial).map(Outcome::Success)
            }
            Self::Rubric => verdict::parse_rubric(answer).map(Outcome::Rubric),
        }
    }
}
