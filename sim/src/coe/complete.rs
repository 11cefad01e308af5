//! Complete access: all subindices of an array or a record in one transfer.
//! Data: with start 0 the count as two bytes (the value and a zero), then the elements from subindex 1 on, one behind the
//! other (ETG.1000.6). Elements are whole bytes here.
//!
//! Assumed where the standard leaves it open: an element that cannot be read is sent as zeros, and one that cannot be
//! written is skipped, as long as there is another that can; a list is as long as its count says.

use super::info::{EntryInfo, ObjectCode};
use super::{Abort, Objects};

/// The bytes of an object from a subindex on.
pub(super) fn upload(objects: &dyn Objects, index: u16, start: u8) -> Result<Vec<u8>, Abort> {
    check(objects, index, start)?;
    let count = count(objects, index)?;
    let mut data = if start == 0 {
        vec![count, 0]
    } else {
        Vec::new()
    };
    let entries = elements(objects, index, count)?;
    if start == 1 && !entries.is_empty() && !entries.iter().any(|(_, entry)| entry.is_readable()) {
        return Err(Abort::WriteOnly);
    }
    for (subindex, entry) in entries {
        if entry.is_readable() {
            data.extend(objects.upload(index, subindex)?);
        } else {
            data.resize(data.len() + entry.bytes(), 0);
        }
    }
    Ok(data)
}

/// The most bytes that can be written to an object from a subindex on.
pub(super) fn room(objects: &dyn Objects, index: u16, start: u8) -> Result<usize, Abort> {
    check(objects, index, start)?;
    let last = objects.object(index)?.last;
    let entries = elements(objects, index, last)?;
    let count_is_writable = objects.entry(index, 0)?.is_writable();
    if !count_is_writable && !entries.iter().any(|(_, entry)| entry.is_writable()) {
        return Err(Abort::ReadOnly);
    }
    let elements: usize = entries.iter().map(|(_, entry)| entry.bytes()).sum();
    Ok(elements + if start == 0 { 2 } else { 0 })
}

/// Writes an object from a subindex on: all of it or nothing.
pub(super) fn download(
    objects: &mut dyn Objects,
    index: u16,
    start: u8,
    data: &[u8],
) -> Result<(), Abort> {
    check(objects, index, start)?;
    let mut values = Vec::new();
    let mut rest = data;
    let mut count = count(objects, index)?;
    let mut written_count = None;
    if start == 0 {
        let (head, elements) = data.split_at_checked(2).ok_or(Abort::TooShort)?;
        rest = elements;
        if objects.entry(index, 0)?.is_writable() {
            // A list is emptied before its elements change and gets its count after them.
            count = head.first().copied().unwrap_or(0);
            values.push((0, vec![0]));
            written_count = Some((0, vec![count]));
        }
    }
    let entries = elements(objects, index, count)?;
    if written_count.is_some() && entries.len() < usize::from(count) {
        return Err(Abort::NoSubindex);
    }
    for (subindex, entry) in entries {
        let (value, behind) = rest
            .split_at_checked(entry.bytes())
            .ok_or(Abort::TooShort)?;
        rest = behind;
        if entry.is_writable() {
            values.push((subindex, value.to_vec()));
        }
    }
    if !rest.is_empty() {
        return Err(Abort::TooLong);
    }
    values.extend(written_count);
    if values.is_empty() {
        return Err(Abort::ReadOnly);
    }
    objects.download_all(index, &values)
}

/// Only arrays and records have complete access, and only from subindex 0 or 1 on.
fn check(objects: &dyn Objects, index: u16, start: u8) -> Result<(), Abort> {
    if objects.object(index)?.code == ObjectCode::Var {
        return Err(Abort::CompleteAccess);
    }
    if start > 1 {
        return Err(Abort::Access);
    }
    Ok(())
}

fn count(objects: &dyn Objects, index: u16) -> Result<u8, Abort> {
    let value = objects.upload(index, 0)?;
    value.first().copied().ok_or(Abort::NoSubindex)
}

/// The elements up to a subindex; those that do not exist take no room.
fn elements(objects: &dyn Objects, index: u16, last: u8) -> Result<Vec<(u8, EntryInfo)>, Abort> {
    let mut all = Vec::new();
    for subindex in 1..=last {
        match objects.entry(index, subindex) {
            Ok(entry) => all.push((subindex, entry)),
            Err(Abort::NoSubindex) => {}
            Err(abort) => return Err(abort),
        }
    }
    Ok(all)
}
