//! Makers' ESI files.

use servocrab::esi::Esi;

use super::memory::within;

/// Bytes that the tree of the XML takes for each byte of the file.
const TREE: usize = 128;
/// Bytes that one entry of a dictionary takes, with its name and while the list of them grows.
const ENTRY: usize = 1024;
/// Entries of a dictionary altogether, and those that one object of the file can have.
const ENTRIES: usize = 1 << 18;
const OF_OBJECT: usize = 256;

/// Reads one file, and makes of its devices what can be made.
pub fn run(data: &[u8]) {
    let objects = data.windows(7).filter(|bytes| bytes == b"<Object").count();
    let entries = (OF_OBJECT * objects).min(ENTRIES);
    let bound = 64 * 1024 + TREE * data.len() + ENTRY * entries;
    let esi = within(bound, || Esi::from_bytes("any", data));
    let Ok(esi) = esi.inspect_err(|error| {
        within(16 * 1024, || error.to_string());
    }) else {
        return;
    };
    for device in &esi.devices {
        within(bound, || {
            if let Ok(description) = device.description() {
                let _ = description.default_mapping();
            }
            let _ = device.start_up_list();
        });
    }
}
