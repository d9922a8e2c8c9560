//! The choice of the middleware.

use crate::Error;

/// What carries messages between processes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Middleware {
    /// DDS, as `rmw_fastrtps_cpp` and `rmw_cyclonedds_cpp` use it.
    #[default]
    Dds,
    /// Zenoh, as `rmw_zenoh_cpp` uses it. Needs the cargo feature `zenoh`.
    Zenoh,
}

/// The middlewares of ROS 2 that use DDS.
const DDS: [&str; 5] = [
    "rmw_fastrtps_cpp",
    "rmw_fastrtps_dynamic_cpp",
    "rmw_cyclonedds_cpp",
    "rmw_connextdds",
    "rmw_gurumdds_cpp",
];

/// The middleware of ROS 2 that uses Zenoh.
const ZENOH: &str = "rmw_zenoh_cpp";

impl Middleware {
    /// The values of `--middleware`.
    pub(crate) const VALUES: &str = "dds or zenoh";

    /// Parses the value of `--middleware`.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        match text {
            "dds" => Some(Self::Dds),
            "zenoh" => Some(Self::Zenoh),
            _ => None,
        }
    }

    /// As `--middleware` takes it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Dds => "dds",
            Self::Zenoh => "zenoh",
        }
    }

    /// The middleware that `RMW_IMPLEMENTATION` names; DDS if it is unset or names an unknown one, of which
    /// [`Environment::warnings`](crate::Environment::warnings) warns.
    ///
    /// # Errors
    /// It names Zenoh, and this program is built without it.
    pub fn from_env() -> Result<Self, Error> {
        let variable = std::env::var("RMW_IMPLEMENTATION").unwrap_or_default(); // unset: the default
        Self::of_rmw(&variable).unwrap_or_default().available()
    }

    /// The middleware of an implementation of ROS 2's middleware interface, `rmw_...`; `None` for an unknown one.
    pub(crate) fn of_rmw(implementation: &str) -> Option<Self> {
        match implementation {
            ZENOH => Some(Self::Zenoh),
            "" => Some(Self::Dds),
            known if DDS.contains(&known) => Some(Self::Dds),
            _ => None,
        }
    }

    /// This middleware, unless the program is built without it.
    pub(crate) fn available(self) -> Result<Self, Error> {
        match self {
            Self::Zenoh if cfg!(not(feature = "zenoh")) => Err(Error::NoZenoh),
            available => Ok(available),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn implementations_name_their_middleware() {
        assert_eq!(Middleware::of_rmw(""), Some(Middleware::Dds));
        for implementation in DDS {
            assert_eq!(Middleware::of_rmw(implementation), Some(Middleware::Dds));
        }
        assert_eq!(Middleware::of_rmw("rmw_zenoh_cpp"), Some(Middleware::Zenoh));
        assert_eq!(Middleware::of_rmw("rmw_email_cpp"), None);
    }

    #[test]
    fn values_of_the_flag_are_parsed() {
        for middleware in [Middleware::Dds, Middleware::Zenoh] {
            assert_eq!(Middleware::parse(middleware.name()), Some(middleware));
        }
        assert_eq!(Middleware::parse("DDS"), None);
    }
}
