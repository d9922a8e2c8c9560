//! What a client has, and its next message. There is no queue: a slow client gets the newest of each kind when it can
//! receive, and skips the rest.

use crate::{album::Kind, state::State};
use axum::extract::ws::Message;
use std::collections::BTreeMap;

#[derive(Debug, Default)]
pub(crate) struct Cursor {
    pictures: BTreeMap<Kind, u64>,
    events: u64,
    status: u64,
    /// The last kind, so that none of the three kinds delays the others.
    last: Turn,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Turn {
    #[default]
    Events,
    Picture,
    Status,
}

impl Turn {
    const fn next(self) -> Self {
        match self {
            Self::Events => Self::Picture,
            Self::Picture => Self::Status,
            Self::Status => Self::Events,
        }
    }
}

/// The last message `status`, with its number.
#[derive(Debug, Default)]
pub(crate) struct Status {
    /// Counts up.
    pub number: u64,
    /// JSON.
    pub message: String,
}

impl Cursor {
    /// The next message, which counts as sent; `None` if the client has everything.
    pub(crate) fn next(&mut self, state: &State, status: &Status) -> Option<Message> {
        let mut turn = self.last;
        for _ in 0..3 {
            turn = turn.next();
            let message = match turn {
                Turn::Picture => self.picture(state),
                Turn::Status => self.status(status),
                Turn::Events => self.events(state),
            };
            if message.is_some() {
                self.last = turn;
                return message;
            }
        }
        None
    }

    fn picture(&mut self, state: &State) -> Option<Message> {
        let (kind, number, picture) = state.album.next(&self.pictures)?;
        self.pictures.insert(kind, number);
        Some(Message::Binary(picture.message()))
    }

    fn status(&mut self, status: &Status) -> Option<Message> {
        if status.number == self.status {
            return None;
        }
        self.status = status.number;
        Some(Message::Text(status.message.clone().into()))
    }

    fn events(&mut self, state: &State) -> Option<Message> {
        // a new client has lost nothing
        if self.events == 0 {
            self.events = state.journal.first();
        }
        let (message, next) = state.journal.batch(self.events)?;
        self.events = next;
        Some(Message::Text(message.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::{Label, Source, tests::picture};
    use std::sync::Arc;
    use wm_msgs::wm_msgs::Action;

    fn see(state: &mut State, stamp_ns: i64) {
        let label = Label::of(Source::Camera, stamp_ns);
        state.picture(Arc::new(picture(label)), stamp_ns);
    }

    fn all(cursor: &mut Cursor, state: &State, status: &Status) -> Vec<Message> {
        std::iter::from_fn(|| cursor.next(state, status)).collect()
    }

    #[test]
    fn stalled_client_gets_only_the_newest() {
        let mut state = State::live(1 << 24);
        let status = Status {
            number: 1,
            message: "{}".to_owned(),
        };
        let mut cursor = Cursor::default();
        see(&mut state, 1);
        let first = all(&mut cursor, &state, &status);
        // the picture comes first: users wait for it
        assert!(
            matches!(first.first(), Some(Message::Binary(_))),
            "{first:?}"
        );
        assert_eq!(first.len(), 3);
        assert!(all(&mut cursor, &state, &status).is_empty());

        for stamp in 2..1000 {
            see(&mut state, stamp);
        }
        let later = all(&mut cursor, &state, &status);
        let binary = later
            .iter()
            .filter(|message| matches!(message, Message::Binary(_)));
        assert_eq!(binary.count(), 1);
        assert!(later.len() < 6, "{}", later.len());
    }

    #[test]
    fn pictures_do_not_delay_events_and_status() {
        let mut state = State::live(1 << 24);
        let mut cursor = Cursor::default();
        let mut kinds = Vec::new();
        for stamp in 1..7 {
            see(&mut state, stamp);
            state.action(&Action::default(), stamp * 1_000_000_000);
            let status = Status {
                number: stamp as u64,
                message: "{}".to_owned(),
            };
            kinds.push(match cursor.next(&state, &status) {
                Some(Message::Binary(_)) => 'p',
                Some(Message::Text(text)) if text.as_str() == "{}" => 's',
                _ => 'e',
            });
        }
        assert_eq!(kinds, ['p', 's', 'e', 'p', 's', 'e']);
    }
}
