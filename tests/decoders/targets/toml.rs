//! Start-up lists and sets of parameters in TOML files.

use servocrab::parameters::{ParameterSet, StartUpList};

use super::memory::within;

/// The first byte chooses: even a start-up list, odd a set of parameters.
pub fn run(data: &[u8]) {
    let Some((kind, text)) = data.split_first() else {
        return;
    };
    // A file that is no UTF-8 is refused as it is read.
    let text = match core::str::from_utf8(text) {
        Ok(text) => text,
        Err(error) => core::str::from_utf8(&text[..error.valid_up_to()]).unwrap_or_default(),
    };
    let bound = 64 * 1024 + 768 * text.len();
    if kind & 1 == 0 {
        if let Err(error) = within(bound, || StartUpList::from_toml(text, "any")) {
            assert!(error.to_string().starts_with("any"));
        }
        return;
    }
    match within(bound, || ParameterSet::from_toml(text, "any")) {
        Err(error) => assert!(error.to_string().starts_with("any")),
        Ok(set) => {
            let written = set.to_toml();
            let again = ParameterSet::from_toml(&written, "again").map(|set| set.to_toml());
            assert_eq!(again, Ok(written));
        }
    }
}
