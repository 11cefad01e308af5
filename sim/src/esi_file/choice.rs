//! Which device of an ESI file is meant.

use std::convert::Infallible;
use std::path::PathBuf;
use std::str::FromStr;

use super::xml::{Element, EsiError};

/// Devices that a message lists.
const LISTED: usize = 16;

/// An ESI file and one of its devices: `FILE[:PRODUCT[:REVISION]]`. Numbers are decimal, or hexadecimal as `0x2A` or `2Ah`.
///
/// ```
/// use servocrab_sim::EsiChoice;
/// let Ok(choice) = "drives.xml:44530402h:0x1".parse::<EsiChoice>();
/// assert_eq!((choice.product, choice.revision), (Some(0x4453_0402), Some(1)));
/// assert_eq!(choice.file.to_str(), Some("drives.xml"));
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EsiChoice {
    /// The file.
    pub file: PathBuf,
    /// The product code; without it the first device of the file is meant.
    pub product: Option<u32>,
    /// The revision; without it the highest of the product.
    pub revision: Option<u32>,
}

impl FromStr for EsiChoice {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        // From the right: a file's name may have colons itself.
        let mut file = text;
        let mut numbers = Vec::new();
        while numbers.len() < 2
            && let Some((rest, last)) = file.rsplit_once(':')
            && let Some(number) = number(last)
        {
            numbers.push(number);
            file = rest;
        }
        Ok(Self {
            file: file.into(),
            product: numbers.pop(),
            revision: numbers.pop(),
        })
    }
}

/// `42`, `0x2A`, `2Ah` or, as in the file itself, `#x2A`.
fn number(text: &str) -> Option<u32> {
    let lower = text.to_ascii_lowercase();
    let digits = lower
        .strip_prefix("0x")
        .or_else(|| lower.strip_prefix("#x"))
        .or_else(|| lower.strip_suffix('h'));
    match digits {
        // A sign is no digit.
        Some(digits) if digits.bytes().all(|digit| digit.is_ascii_hexdigit()) => {
            u32::from_str_radix(digits, 16).ok()
        }
        Some(_) => None,
        None if lower.bytes().all(|digit| digit.is_ascii_digit()) => lower.parse().ok(),
        None => None,
    }
}

/// The device that is meant: the first one, or by product code, of the highest revision where none is given.
pub(super) fn device<'a>(
    root: &Element<'a>,
    product: Option<u32>,
    revision: Option<u32>,
) -> Result<Element<'a>, EsiError> {
    let all = root.all("Descriptions");
    let all = all.flat_map(|all| all.all("Devices"));
    let mut all = all.flat_map(|devices| devices.all("Device"));
    let Some(product) = product else {
        return all
            .next()
            .ok_or_else(|| root.error("there is no device in this file"));
    };
    let mut found: Option<(u32, Element<'a>)> = None;
    let mut listed = Vec::new();
    for device in all {
        let kind = device.need("Type")?;
        let own = kind.attribute_number("ProductCode")?.unwrap_or(0);
        let of: u32 = kind.attribute_number("RevisionNo")?.unwrap_or(0);
        listed.push(format!("{own:08X}h:{of:08X}h"));
        let is_meant = own == product && revision.is_none_or(|revision| of == revision);
        if is_meant && found.is_none_or(|(highest, _)| of > highest) {
            found = Some((of, device));
        }
    }
    found.map(|(_, device)| device).ok_or_else(|| {
        let revision = revision.map(|revision| format!(" and revision {revision:08X}h"));
        let more = listed.len().saturating_sub(LISTED);
        listed.truncate(LISTED);
        let more = if more == 0 {
            String::new()
        } else {
            format!(" and {more} more")
        };
        root.error(format!(
            "there is no device of product {product:08X}h{}; the file has {}{more}",
            revision.unwrap_or_default(),
            listed.join(", ")
        ))
    })
}
