//! The protocol of a socket.

use crate::foxglove;
use axum::http::{HeaderMap, header};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Subprotocol {
    /// The page's own.
    View,
    /// One of Foxglove's, by its name.
    Foxglove(&'static str),
}

impl Subprotocol {
    /// Chooses one of the subprotocols that a client offers, the page's first; `None` if all are unknown.
    pub(crate) fn of(headers: &HeaderMap) -> Option<Self> {
        let offers = |name: &str| offered(headers).any(|offered| offered == name);
        if offers(Self::View.name()) {
            return Some(Self::View);
        }
        let mut foxglove = foxglove::PROTOCOLS.into_iter();
        foxglove.find(|name| offers(name)).map(Self::Foxglove)
    }

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::View => "wm.view.v1",
            Self::Foxglove(name) => name,
        }
    }
}

/// The subprotocols that a client offers.
pub(crate) fn offered(headers: &HeaderMap) -> impl Iterator<Item = &str> {
    let lists = headers.get_all(header::SEC_WEBSOCKET_PROTOCOL).into_iter();
    let lists = lists.filter_map(|value| value.to_str().ok());
    lists.flat_map(|list| list.split(',')).map(str::trim)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_subprotocol_precedes_foxgloves() {
        let of = |lists: &[&str]| {
            let mut headers = HeaderMap::new();
            for list in lists {
                headers.append(header::SEC_WEBSOCKET_PROTOCOL, list.parse().unwrap());
            }
            Subprotocol::of(&headers).map(Subprotocol::name)
        };
        assert_eq!(of(&[]), None);
        assert_eq!(of(&["other, wm.token.x"]), None);
        assert_eq!(
            of(&["foxglove.websocket.v1"]),
            Some("foxglove.websocket.v1")
        );
        assert_eq!(
            of(&["foxglove.websocket.v1, foxglove.sdk.v1"]),
            Some("foxglove.sdk.v1")
        );
        assert_eq!(of(&["foxglove.sdk.v1,wm.view.v1"]), Some("wm.view.v1"));
        assert_eq!(of(&["foxglove.sdk.v1", "wm.view.v1"]), Some("wm.view.v1"));
    }
}
