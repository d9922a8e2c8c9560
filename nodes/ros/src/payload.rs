//! The content of a sample: CDR bytes, or a message of this process that is not encoded yet.

use bytes::Bytes;
use std::{
    any::Any,
    fmt,
    sync::{Arc, OnceLock},
};
use wm_msgs::{
    Message,
    cdr::{self, CdrError},
};

/// The content of a sample. Clones share it.
#[derive(Clone)]
pub(crate) enum Payload {
    /// CDR with its 4-byte header.
    Cdr(Bytes),
    /// A message published in this process.
    Message(Arc<Encodable>),
}

/// A message that is encoded at the first request for its bytes, and only once.
pub(crate) struct Encodable {
    message: Arc<dyn Any + Send + Sync>,
    encode: fn(&(dyn Any + Send + Sync)) -> Result<Vec<u8>, CdrError>,
    cdr: OnceLock<Bytes>,
}

impl Payload {
    /// A message that is passed on unencoded within this process.
    pub(crate) fn of<M: Message>(message: Arc<M>) -> Self {
        Self::Message(Arc::new(Encodable {
            message,
            encode: encode::<M>,
            cdr: OnceLock::new(),
        }))
    }

    /// The CDR bytes with their 4-byte header.
    pub(crate) fn cdr(&self) -> Result<Bytes, CdrError> {
        match self {
            Self::Cdr(bytes) => Ok(bytes.clone()),
            Self::Message(message) => message.cdr(),
        }
    }

    /// As [`cdr`](Self::cdr).
    pub(crate) fn into_cdr(self) -> Result<Bytes, CdrError> {
        self.cdr()
    }

    /// The message, decoded unless it is an `M` of this process.
    pub(crate) fn into_message<M: Message>(self) -> Result<Arc<M>, CdrError> {
        if let Self::Message(shared) = &self
            && let Ok(message) = Arc::clone(&shared.message).downcast()
        {
            return Ok(message);
        }
        cdr::from_bytes(&self.cdr()?).map(Arc::new)
    }

    /// Size of the CDR bytes \[byte\], if the message is encoded.
    pub(crate) fn encoded_len(&self) -> Option<usize> {
        match self {
            Self::Cdr(bytes) => Some(bytes.len()),
            Self::Message(message) => message.cdr.get().map(Bytes::len),
        }
    }
}

impl Encodable {
    fn cdr(&self) -> Result<Bytes, CdrError> {
        if let Some(bytes) = self.cdr.get() {
            return Ok(bytes.clone());
        }
        let bytes = Bytes::from((self.encode)(&*self.message)?);
        Ok(self.cdr.get_or_init(|| bytes).clone())
    }
}

fn encode<M: Message>(message: &(dyn Any + Send + Sync)) -> Result<Vec<u8>, CdrError> {
    match message.downcast_ref::<M>() {
        Some(message) => cdr::to_bytes(message),
        // never: `Payload::of` pairs this function with an `M`
        None => Err(CdrError::NoHeader(0)),
    }
}

impl fmt::Debug for Payload {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.encoded_len() {
            Some(len) => write!(f, "{len} bytes"),
            None => f.write_str("a message of this process"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::std_msgs;

    #[test]
    fn a_message_is_encoded_once_and_only_on_demand() {
        let message = Arc::new(std_msgs::String { data: "x".into() });
        let payload = Payload::of(Arc::clone(&message));
        let shared: Arc<std_msgs::String> = payload.clone().into_message().unwrap();
        assert!(Arc::ptr_eq(&shared, &message));
        assert_eq!(payload.encoded_len(), None);

        let bytes = payload.cdr().unwrap();
        assert_eq!(bytes, cdr::to_bytes(&*message).unwrap());
        assert_eq!(payload.clone().cdr().unwrap().as_ptr(), bytes.as_ptr());
        // another type is decoded from the bytes, or an error
        assert!(payload.into_message::<std_msgs::Bool>().is_err());
    }
}
