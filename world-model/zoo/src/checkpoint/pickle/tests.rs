use proptest::prelude::*;

use super::*;

fn parse(bytes: &[u8]) -> Result<Pickle<'_>, String> {
    Pickle::parse(bytes)
}

#[test]
fn what_is_remembered_is_shared() {
    // x = {}; {"a": x, "b": x}, x filled after it was remembered.
    let bytes =
        b"\x80\x02}(X\x01\x00\x00\x00a}q\x01X\x01\x00\x00\x00kK\x05sX\x01\x00\x00\x00bh\x01u.";
    let pickle = parse(bytes).unwrap();
    let Value::Dict(items) = pickle.get(pickle.root()) else {
        panic!("no dictionary");
    };
    let of: Vec<Id> = items.iter().map(|(_, value)| *value).collect();
    assert_eq!(of[0], of[1]);
    assert!(matches!(pickle.get(of[1]), Value::Dict(items) if items.len() == 1));
}

#[test]
fn newer_protocols_are_read() {
    // pickle.dumps({"a": (1, -1, True)}, protocol=4)
    let bytes = b"\x80\x04\x95\x16\x00\x00\x00\x00\x00\x00\x00}\x94\x8c\x01a\x94K\x01J\xff\xff\xff\xff\x88\x87\x94s.";
    let pickle = parse(bytes).unwrap();
    let Value::Dict(items) = pickle.get(pickle.root()) else {
        panic!("no dictionary");
    };
    assert_eq!(pickle.get(items[0].0), &Value::Text("a"));
    let Value::Sequence(items) = pickle.get(items[0].1) else {
        panic!("no tuple");
    };
    let values: Vec<&Value<'_>> = items.iter().map(|id| pickle.get(*id)).collect();
    assert_eq!(
        values,
        [&Value::Int(1), &Value::Int(-1), &Value::Bool(true)]
    );
}

#[test]
fn long_numbers_have_their_sign() {
    assert_eq!(long(&[]), Value::Int(0));
    assert_eq!(long(&[0xff]), Value::Int(-1));
    assert_eq!(long(&[0xff, 0]), Value::Int(255));
    assert_eq!(long(&[0; 9]), Value::Opaque);
}

#[test]
fn what_is_damaged_says_where() {
    for (bytes, expected) in [
        (&b"\x80\x02"[..], "1 bytes expected at 2"),
        (b"\x80\x02X\xff\xff\xff\xffab", "byte 2"),
        (b"\x80\x02R.", "byte 2"),
        (b"\x80\x02h\x07.", "the memo has no entry 7"),
        (b"\x80\x02\xfe", "unknown instruction 0xfe"),
        (b"\x80\x02K\x01(K\x02s.", "empty"),
    ] {
        let error = parse(bytes).unwrap_err();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn deep_nesting_is_no_trouble() {
    let mut bytes = vec![0x80, 2, b')'];
    bytes.extend(vec![0x85; 1_000_000]);
    bytes.push(b'.');
    drop(parse(&bytes).unwrap());
}

proptest! {
    #[test]
    fn no_bytes_cause_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        if let Ok(pickle) = Pickle::parse(&bytes) {
            crate::checkpoint::state_dict::tensors(&pickle).ok();
        }
    }

    #[test]
    fn no_instructions_cause_a_panic(
        codes in proptest::collection::vec(
            proptest::sample::select(&b"(012N)]}\x85\x86\x87tldaesuRQbq\x01h\x01K\x02.\x88\x81\x94"[..]),
            0..200,
        ),
    ) {
        if let Ok(pickle) = Pickle::parse(&codes) {
            crate::checkpoint::state_dict::tensors(&pickle).ok();
        }
    }
}
