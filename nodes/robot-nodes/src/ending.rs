//! How a command that moves data ended.

use std::process::ExitCode;

/// Whether everything arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Ending {
    /// All of it.
    Complete,
    /// The command finished, but messages were lost on the way. It said which.
    DataLost,
}

impl Ending {
    /// `DataLost` if `is_lost`.
    pub fn lost_if(is_lost: bool) -> Self {
        if is_lost {
            Self::DataLost
        } else {
            Self::Complete
        }
    }
}

impl From<Ending> for ExitCode {
    /// 0 and 3; 1 is a failure and 2 wrong usage.
    fn from(ending: Ending) -> Self {
        match ending {
            Ending::Complete => Self::SUCCESS,
            Ending::DataLost => Self::from(3),
        }
    }
}
