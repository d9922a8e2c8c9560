//! Announcements of the other bridges on the Zenoh network.

use crate::announcement::Announcement;
use anyhow::{Result, anyhow};
use std::{
    collections::BTreeSet,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};
use tokio::sync::Notify;
use zenoh::{
    Session,
    key_expr::OwnedKeyExpr,
    liveliness::LivelinessToken,
    pubsub::Subscriber,
    sample::{Sample, SampleKind},
};

/// The most announcements; limits what a stranger can make this side open.
const MOST: usize = 4096;
/// The longest announcement \[byte\]: far longer than ROS names, which have at most 255.
const LONGEST: usize = 1024;

/// Where bridges of this kind announce their DDS participant: `@/<zenoh id>/@wm_bridge/<GUID prefix>`.
const PRESENCES: &str = "@/*/@wm_bridge/*";

/// Another bridge of this kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Presence {
    pub bridge: String,
    /// The GUID prefix of its DDS participant.
    pub participant: [u8; 12],
}

impl Presence {
    pub(crate) fn token(&self) -> Result<OwnedKeyExpr, zenoh::Error> {
        let participant: String = self
            .participant
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        OwnedKeyExpr::new(format!("@/{}/@wm_bridge/{participant}", self.bridge))
    }

    fn parse(token: &str) -> Option<Self> {
        let parts: Vec<&str> = token.split('/').collect();
        let ["@", bridge, "@wm_bridge", hex] = parts[..] else {
            return None;
        };
        if hex.len() != 24 {
            return None;
        }
        let mut participant = [0; 12];
        for (index, byte) in participant.iter_mut().enumerate() {
            let digits = hex.get(2 * index..2 * index + 2)?;
            *byte = u8::from_str_radix(digits, 16).ok()?;
        }
        Some(Self {
            bridge: bridge.to_owned(),
            participant,
        })
    }
}

#[derive(Default)]
struct Tokens {
    alive: Mutex<BTreeSet<String>>,
    /// Announcements that were too many or too long.
    refused: AtomicU64,
    changed: Notify,
}

impl Tokens {
    /// a set has no invariant that a panic could break
    fn alive(&self) -> MutexGuard<'_, BTreeSet<String>> {
        self.alive.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn follow(&self, sample: &Sample) {
        let token = sample.key_expr().as_str();
        let mut alive = self.alive();
        match sample.kind() {
            SampleKind::Put if alive.contains(token) => {}
            SampleKind::Put if alive.len() >= MOST || token.len() > LONGEST => {
                if self.refused.fetch_add(1, Ordering::Relaxed) == 0 {
                    tracing::warn!(
                        "announcements beyond {MOST}, or of more than {LONGEST} bytes, are ignored"
                    );
                }
            }
            SampleKind::Put => {
                alive.insert(token.to_owned());
            }
            SampleKind::Delete => {
                alive.remove(token);
            }
        }
        drop(alive);
        self.changed.notify_one();
    }
}

/// The other bridges.
pub(crate) struct Others {
    tokens: Arc<Tokens>,
    own_id: String,
    _subscribers: [Subscriber<()>; 2],
    _presence: LivelinessToken,
}

impl Others {
    /// Announces this bridge's participant, and follows the other bridges from now on.
    ///
    /// # Errors
    /// The session is closed.
    pub(crate) async fn join(session: &Session, participant: [u8; 12]) -> Result<Self> {
        let failed = |error| anyhow!("cannot follow the other bridges: {error}");
        let tokens = Arc::new(Tokens::default());
        let subscribe = async |keys: &'static str| {
            let tokens = Arc::clone(&tokens);
            session
                .liveliness()
                .declare_subscriber(keys)
                .history(true)
                .callback(move |sample| tokens.follow(&sample))
                .await
                .map_err(failed)
        };
        let subscribers = [
            subscribe(Announcement::ALL).await?,
            subscribe(PRESENCES).await?,
        ];
        let own_id = session.zid().to_string();
        let presence = Presence {
            bridge: own_id.clone(),
            participant,
        };
        let token = presence.token().map_err(failed)?;
        let presence = session
            .liveliness()
            .declare_token(token)
            .await
            .map_err(failed)?;
        Ok(Self {
            tokens,
            own_id,
            _subscribers: subscribers,
            _presence: presence,
        })
    }

    /// Waits for changed announcements. Cancel safe.
    pub(crate) async fn changed(&self) {
        self.tokens.changed.notified().await;
    }

    /// How many announcements were rejected.
    pub(crate) fn refused(&self) -> u64 {
        self.tokens.refused.load(Ordering::Relaxed)
    }

    /// Their topics and services.
    pub(crate) fn announcements(&self) -> Vec<Announcement> {
        let alive = self.tokens.alive();
        let announcements = alive
            .iter()
            .filter_map(|token| match Announcement::parse(token) {
                Ok(announcement) => Some(announcement),
                Err(error) => {
                    tracing::debug!("{error}");
                    None
                }
            });
        announcements
            .filter(|announcement| announcement.bridge != self.own_id)
            .collect()
    }

    /// The bridges of this kind.
    pub(crate) fn presences(&self) -> Vec<Presence> {
        let alive = self.tokens.alive();
        let presences = alive.iter().filter_map(|token| Presence::parse(token));
        presences
            .filter(|presence| presence.bridge != self.own_id)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_presence_survives(bridge in "[0-9a-f]{1,32}", participant: [u8; 12]) {
            let presence = Presence { bridge, participant };
            prop_assert_eq!(Presence::parse(&presence.token().unwrap()), Some(presence));
        }

        #[test]
        fn no_token_panics(token in "@/a/@wm_bridge/(\\PC{0,26}|[0-9a-fä]{24})") {
            let _ = Presence::parse(&token);
        }
    }
}
