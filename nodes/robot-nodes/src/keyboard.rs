//! Keys that are pressed in the terminal of a node which runs in its foreground.

use rustix::termios::{
    LocalModes, OptionalActions, SpecialCodeIndex, Termios, isatty, tcgetattr, tcgetpgrp, tcsetattr,
};
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;

/// A key with a meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// The space bar.
    Space,
    /// Cursor right.
    Right,
    /// Cursor up.
    Up,
    /// Cursor down.
    Down,
}

/// Finds keys in the bytes of a terminal, in pieces of any size.
#[derive(Debug, Default)]
pub struct Decoder {
    /// Bytes of an escape sequence so far.
    sequence: Vec<u8>,
}

impl Decoder {
    /// The key that this byte completes.
    pub fn push(&mut self, byte: u8) -> Option<Key> {
        const ESCAPE: u8 = 0x1b;
        match (self.sequence.as_slice(), byte) {
            (_, ESCAPE) => self.sequence = vec![ESCAPE],
            // cursor keys are ESC [ A, or ESC O A in application mode
            ([ESCAPE], b'[' | b'O') => self.sequence.push(byte),
            ([ESCAPE, _], _) => {
                // modifiers come as parameters before the letter: not ours
                self.sequence.clear();
                return match byte {
                    b'A' => Some(Key::Up),
                    b'B' => Some(Key::Down),
                    b'C' => Some(Key::Right),
                    _ => None,
                };
            }
            ([], b' ') => return Some(Key::Space),
            _ => self.sequence.clear(),
        }
        None
    }
}

/// Keys that may wait for the node.
const WAITING: usize = 16;

/// The keys of a node, if it has a terminal.
pub struct Keys {
    receiver: mpsc::Receiver<Key>,
    keyboard: Option<Keyboard>,
}

impl Keys {
    /// Reads the keys from now on, if they are wanted and the terminal is this process's.
    #[must_use]
    pub fn new(is_wanted: bool) -> Self {
        let (sender, receiver) = mpsc::channel(WAITING);
        // A key that finds the queue full is pressed again.
        let on_key = move |key| {
            sender.try_send(key).ok();
        };
        let keyboard = is_wanted.then(|| Keyboard::listen(on_key)).flatten();
        Self { receiver, keyboard }
    }

    /// Whether keys are read.
    #[must_use]
    pub fn are_read(&self) -> bool {
        self.keyboard.is_some()
    }

    /// The next key; pending if none are read. Cancel safe.
    pub async fn next(&mut self) -> Key {
        match self.receiver.recv().await {
            Some(key) => key,
            None => std::future::pending().await,
        }
    }
}

/// Reads keys without waiting for a new line and without showing them, until it is dropped; the terminal is then as it
/// was.
struct Keyboard {
    before: Termios,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Tenths of a second after which a read ends without a key, so that its thread sees the end.
const PATIENCE_DS: u8 = 1;

impl Keyboard {
    /// Calls `on_key` on a separate thread for each key. `None` if standard input is no terminal, or if another process is in
    /// the terminal's foreground.
    fn listen(on_key: impl Fn(Key) + Send + 'static) -> Option<Self> {
        let terminal = rustix::stdio::stdin();
        let is_ours = isatty(terminal)
            && tcgetpgrp(terminal).is_ok_and(|group| group == rustix::process::getpgrp());
        let before = is_ours.then(|| tcgetattr(terminal).ok()).flatten()?;
        let mut keys = before.clone();
        // signals stay, so that Ctrl-C ends the process
        keys.local_modes -= LocalModes::ICANON | LocalModes::ECHO;
        keys.special_codes[SpecialCodeIndex::VMIN] = 0;
        keys.special_codes[SpecialCodeIndex::VTIME] = PATIENCE_DS;
        tcsetattr(terminal, OptionalActions::Now, &keys).ok()?;
        let is_over = Arc::new(AtomicBool::new(false));
        let mut keyboard = Self {
            before,
            is_over: Arc::clone(&is_over),
            thread: None,
        };
        let thread = std::thread::Builder::new().name("keys".to_owned());
        keyboard.thread = thread.spawn(move || read(&is_over, on_key)).ok();
        Some(keyboard)
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
        tcsetattr(rustix::stdio::stdin(), OptionalActions::Now, &self.before).ok();
    }
}

fn read(is_over: &AtomicBool, on_key: impl Fn(Key)) {
    let mut decoder = Decoder::default();
    let mut bytes = [0; 64];
    while !is_over.load(Ordering::Relaxed) {
        let begin = Instant::now();
        let read = match rustix::io::read(rustix::stdio::stdin(), &mut bytes) {
            Ok(read) => read,
            Err(rustix::io::Errno::INTR) => continue,
            Err(_) => return,
        };
        // nothing, and at once: the terminal has hung up
        if read == 0 && begin.elapsed() < Duration::from_millis(u64::from(PATIENCE_DS) * 50) {
            return;
        }
        let pressed = bytes.iter().take(read);
        pressed
            .filter_map(|byte| decoder.push(*byte))
            .for_each(&on_key);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_among_other_bytes() {
        let decoded = |bytes: &[u8]| {
            let mut decoder = Decoder::default();
            bytes
                .iter()
                .filter_map(|byte| decoder.push(*byte))
                .collect::<Vec<_>>()
        };
        assert_eq!(
            decoded(b" \x1b[C\x1bOAx\x1b[B "),
            [Key::Space, Key::Right, Key::Up, Key::Down, Key::Space]
        );
        // cursor left, a lone escape before a key, a key with a modifier, half a sequence
        assert_eq!(decoded(b"\x1b[D\x1b\x1b[A"), [Key::Up]);
        assert_eq!(decoded(b"\x1b[1;5C"), []);
        assert_eq!(decoded(b"\x1b["), []);
    }
}
