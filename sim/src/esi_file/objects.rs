//! The dictionary of an ESI file: objects, unfolded by their data types, with their values at power-up.

use std::collections::BTreeMap;

use super::Part;
use super::xml::{Element, EsiError, hexadecimal_digits};
use crate::drive::{PlainEntry, PlainObject};

/// Entries that a dictionary can have here: a short file can name long types often.
const MOST_ENTRIES: usize = 1 << 16;
/// The longest value of an entry, in bytes.
const LONGEST: u32 = 4096;

/// Access and mapping of an entry, in which a subitem follows its object where it says nothing.
#[derive(Clone, Copy)]
struct Flags {
    readable: bool,
    writable: bool,
    outputs: bool,
    inputs: bool,
}

impl Flags {
    fn of(element: &Element<'_>, otherwise: Self) -> Self {
        let Some(flags) = element.at(&["Flags"]) else {
            return otherwise;
        };
        let mapping = flags.text_of("PdoMapping").to_lowercase();
        let access = flags.text_of("Access");
        Self {
            readable: access.contains('r') || access.is_empty(),
            writable: access.contains('w'),
            outputs: mapping.contains('r'),
            inputs: mapping.contains('t'),
        }
    }
}

/// The objects of the dictionaries of a device and of the modules in its slots. A module may use the device's data types.
pub(super) fn read(
    parts: &[Part<'_>],
    warnings: &mut Vec<String>,
) -> Result<Vec<PlainObject>, EsiError> {
    let of_device = parts.first().and_then(Part::dictionary);
    let mut objects = Vec::new();
    let mut room = MOST_ENTRIES;
    for part in parts {
        let Some(own) = part.dictionary() else {
            continue;
        };
        let types: BTreeMap<&str, Element<'_>> = of_device
            .into_iter()
            .chain([own])
            .flat_map(|dictionary| dictionary.all("DataTypes"))
            .flat_map(|types| types.all("DataType"))
            .map(|kind| (kind.text_of("Name"), kind))
            .collect();
        for element in own.all("Objects").flat_map(|all| all.all("Object")) {
            let object = object(&element, &types, part, warnings)?;
            room = room
                .checked_sub(object.entries.len())
                .ok_or_else(|| element.error(format!("more than {MOST_ENTRIES} entries")))?;
            objects.push(object);
        }
    }
    Ok(objects)
}

fn object(
    element: &Element<'_>,
    types: &BTreeMap<&str, Element<'_>>,
    part: &Part<'_>,
    warnings: &mut Vec<String>,
) -> Result<PlainObject, EsiError> {
    let read_only = Flags {
        readable: true,
        writable: false,
        outputs: false,
        inputs: false,
    };
    let flags = Flags::of(element, read_only);
    let name: String = element.text_of("Name").chars().take(128).collect();
    let type_name = element.text_of("Type");
    let subitems: Vec<Element<'_>> = types
        .get(type_name)
        .map(|kind| kind.all("SubItem").collect())
        .unwrap_or_default();
    let mut object = PlainObject {
        index: part.index(&element.need("Index")?)?,
        name,
        is_array: false,
        entries: Vec::new(),
    };
    let defaults: Vec<Element<'_>> = element
        .at(&["Info"])
        .map(|info| info.all("SubItem").collect())
        .unwrap_or_default();
    if subitems.is_empty() {
        let bits = element.number_of("BitSize")?.unwrap_or(0);
        let info = element.at(&["Info"]);
        let mut entry = entry(0, &object.name, type_name, bits, flags, element)?;
        entry.default = default(info.as_ref(), &entry, warnings)?;
        object.entries.push(entry);
        return Ok(object);
    }
    for item in subitems {
        let kind = item.text_of("Type");
        let bits: u32 = item.number_of("BitSize")?.unwrap_or(0);
        let flags = Flags::of(&item, flags);
        if let Some(subindex) = item.number_of("SubIdx")? {
            let name: String = item.text_of("Name").chars().take(128).collect();
            object
                .entries
                .push(entry(subindex, &name, kind, bits, flags, &item)?);
            continue;
        }
        let Some(array) = types.get(kind) else {
            return Err(item.error(format!("there is no data type {kind:?}")));
        };
        let bounds = array.need("ArrayInfo")?;
        let first = bounds.number_of("LBound")?.unwrap_or(1).max(1);
        let elements: u8 = bounds.need("Elements")?.number()?;
        let base = array.text_of("BaseType");
        object.is_array = true;
        for subindex in (first..=u8::MAX).take(usize::from(elements)) {
            let bits = bits.checked_div(elements.into()).unwrap_or(0);
            let name = object.name.clone();
            object
                .entries
                .push(entry(subindex, &name, base, bits, flags, &item)?);
        }
    }
    // One for each subindex, in their order.
    for (place, entry) in object.entries.iter_mut().enumerate() {
        let info = defaults.get(place).and_then(|item| item.at(&["Info"]));
        entry.default = default(info.as_ref(), entry, warnings)?;
    }
    let last = object.entries.iter().map(|entry| entry.subindex).max();
    let count = object.entries.iter_mut().find(|entry| entry.subindex == 0);
    if let Some(count) = count
        && count.default.is_none()
    {
        count.default = last.map(|last| vec![last]);
    }
    Ok(object)
}

fn entry(
    subindex: u8,
    name: &str,
    kind: &str,
    bits: u32,
    flags: Flags,
    place: &Element<'_>,
) -> Result<PlainEntry, EsiError> {
    if bits > 8 * LONGEST {
        return Err(place.error(format!("a value of {bits} bits is longer than any here")));
    }
    Ok(PlainEntry {
        subindex,
        name: name.to_owned(),
        data_type: number_of_type(kind),
        bytes: bits.div_ceil(8) as usize,
        varies: kind.contains("STRING"),
        default: None,
        readable: flags.readable,
        writable: flags.writable,
        outputs: flags.outputs,
        inputs: flags.inputs,
    })
}

/// The value at power-up: bytes in hexadecimal digits, a number, or a text. As devices take it: a short one is filled with 0, and of a long
/// one, or of none that is understood, a warning says what is held.
fn default(
    info: Option<&Element<'_>>,
    entry: &PlainEntry,
    warnings: &mut Vec<String>,
) -> Result<Option<Vec<u8>>, EsiError> {
    let Some(info) = info else {
        return Ok(None);
    };
    let quoted = |element: &Element<'_>| -> String { element.text().chars().take(40).collect() };
    let (element, mut value) = if let Some(element) = info.at(&["DefaultData"]) {
        let digits = hexadecimal(element.text());
        let wrong = || element.error(format!("{:?} is no value", quoted(&element)));
        let value = digits.ok_or_else(wrong)?;
        (element, value)
    } else if let Some(element) = info.at(&["DefaultString"]) {
        (element, element.text().as_bytes().to_vec())
    } else if let Some(element) = info.at(&["DefaultValue"]) {
        let value = number(element.text(), entry.bytes);
        (element, value.unwrap_or_default())
    } else {
        return Ok(None);
    };
    let is_missing = value.is_empty() && !element.text().is_empty();
    if is_missing || value.len() > entry.bytes {
        let why = format!(
            "{:?} is no value of {} bytes",
            quoted(&element),
            entry.bytes
        );
        value.truncate(entry.bytes);
        let held = if is_missing { "0" } else { "its beginning" };
        warnings.push(element.error(format!("{why}: {held} is taken")).to_string());
    }
    if !entry.varies {
        value.resize(entry.bytes, 0);
    }
    Ok(Some(value))
}

fn hexadecimal(text: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u8>> = text
        .chars()
        .filter(|digit| !digit.is_whitespace())
        .map(|digit| digit.to_digit(16).map(|digit| digit as u8))
        .collect();
    let digits = digits?;
    let (pairs, rest) = digits.as_chunks::<2>();
    rest.is_empty()
        .then(|| pairs.iter().map(|[high, low]| high << 4 | low).collect())
}

/// A number in as many bytes, little-endian; longer where it needs more.
fn number(text: &str, bytes: usize) -> Option<Vec<u8>> {
    let number: i128 = match hexadecimal_digits(text) {
        Some(digits) => i128::from(u64::from_str_radix(digits, 16).ok()?),
        None => text.parse().ok()?,
    };
    let sign = if number < 0 { 0xFF } else { 0 };
    let mut value = number.to_le_bytes().to_vec();
    while value.len() > bytes && value.last() == Some(&sign) {
        value.pop();
    }
    value.resize(value.len().max(bytes), sign);
    Some(value)
}

/// ETG.1000.6, basic data types; 0 for those that the maker has defined.
pub(super) fn number_of_type(name: &str) -> u16 {
    match name {
        "BOOL" | "BIT" => 0x01,
        "SINT" => 0x02,
        "INT" => 0x03,
        "DINT" => 0x04,
        "USINT" | "BYTE" => 0x05,
        "UINT" | "WORD" => 0x06,
        "UDINT" | "DWORD" => 0x07,
        "REAL" => 0x08,
        "LREAL" => 0x11,
        "LINT" => 0x15,
        "ULINT" => 0x1B,
        _ if name.starts_with("STRING") => 0x09,
        _ => 0,
    }
}
