//! What a participant says of itself that does not exist, byte by byte (DDSI-RTPS 2.5).

use std::net::Ipv4Addr;

/// Little-endian words.
pub fn words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// Who it is, if its DDS implementation is that of this vendor.
pub fn prefix(vendor: u8) -> [u8; 12] {
    [1, vendor, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]
}

/// The header of its messages (8.3.3).
pub fn header(vendor: u8) -> Vec<u8> {
    [&b"RTPS\x02\x04\x01"[..], &[vendor], &prefix(vendor)].concat()
}

/// An SPDP announcement (8.5.3) of one that listens at this address and port.
pub fn announcement(vendor: u8, address: Ipv4Addr, port: u16) -> Vec<u8> {
    let locator = [words(&[1, port.into(), 0, 0, 0]), address.octets().to_vec()].concat();
    let guid = [&prefix(vendor)[..], &[0, 0, 1, 0xc1]].concat();
    let parameters: [(u16, Vec<u8>); 7] = [
        (0x15, vec![2, 4, 0, 0]),
        (0x16, vec![1, vendor, 0, 0]),
        (0x50, guid),
        (0x32, locator.clone()),
        (0x31, locator),
        (0x02, words(&[20, 0])),
        (0x58, words(&[0x0c3f])),
    ];
    let mut message = header(vendor);
    // DATA with a payload, to any reader, from the announcing writer, number 1; parameters in little-endian CDR
    message.extend([0x15, 5, 0, 0, 0, 0, 16, 0, 0, 0, 0, 0, 0, 1, 0, 0xc2]);
    message.extend(words(&[0, 1]));
    message.extend([0, 3, 0, 0]);
    for (parameter, value) in parameters {
        message.extend(parameter.to_le_bytes());
        message.extend((value.len() as u16).to_le_bytes());
        message.extend(value);
    }
    message.extend([1, 0, 0, 0]);
    message
}
