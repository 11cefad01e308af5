//! Transfers of every length around every boundary, both ways, and complete access.

use std::collections::BTreeSet;

use servocrab::coe::{AbortCode, DriveError, SdoError, obj};
use servocrab_sim::personality::Servo;

use crate::{with_device, with_drive};

/// A text of up to 4096 bytes.
const NOTE: u16 = 0x5F00;

/// Lengths around every boundary of transfers through a mailbox of `mailbox` bytes: what fits the command, the first
/// message, and each number of segments.
fn lengths(mailbox: usize) -> BTreeSet<usize> {
    let (first, segment) = (mailbox - 16, mailbox - 9);
    let whole = (0..).map(|count| first + count * segment);
    let ends = whole.take_while(|end| *end <= 4096).collect::<Vec<_>>();
    let few = [ends.first(), ends.get(1), ends.get(2), ends.last()];
    let around = |edge: usize| edge.saturating_sub(1)..=edge + 1;
    // The shortest segment is padded to seven bytes.
    let padded = ends.iter().take(2).flat_map(|end| end + 6..=end + 8);
    few.into_iter()
        .flatten()
        .flat_map(|end| around(*end))
        .chain(padded)
        .chain(around(4))
        .chain([1, 2, 7, 8, 4095, 4096])
        .filter(|length| (1..=4096).contains(length))
        .collect()
}

fn text(length: usize) -> Vec<u8> {
    (0..length).map(|at| (at % 251) as u8 + 1).collect()
}

#[test]
fn texts_of_all_lengths_go_both_ways_through_mailboxes_of_all_lengths() {
    for mailbox in [32u16, 48, 64, 127, 128, 256, 512, 1024] {
        let device = Servo::akd2g().mailbox_bytes(mailbox).build();
        let mut seen = 0;
        with_device(device, async |_, handle, _| {
            for length in lengths(usize::from(mailbox)) {
                let text = text(length);
                handle.write_bytes(NOTE, 0, text.clone()).await?;
                let read = handle.read_bytes(NOTE, 0).await?;
                assert!(read == text, "{length} bytes through {mailbox}");
                seen += 1;
            }
            Ok::<_, DriveError>(())
        })
        .unwrap();
        assert!(seen >= 15, "{seen} lengths");
    }
}

#[test]
fn a_text_longer_than_the_object_is_refused_and_the_next_transfer_works() {
    for mailbox in [64, 1024] {
        let device = Servo::akd2g().mailbox_bytes(mailbox).build();
        with_device(device, async |_, handle, _| {
            let refused = handle.write_bytes(NOTE, 0, text(4097)).await;
            let code = refused.unwrap_err().error.abort_code();
            assert_eq!(code, Some(AbortCode(0x0607_0012)));
            handle.write_bytes(NOTE, 0, text(300)).await.unwrap();
            assert_eq!(handle.read_bytes(NOTE, 0).await.unwrap(), text(300));
        });
    }
}

#[test]
fn complete_access_has_the_count_in_two_bytes_and_the_elements_behind_it() {
    // With mailboxes of 32 bytes what is longer than 16 comes in segments.
    for mailbox in [32, 256] {
        let device = Servo::generic().mailbox_bytes(mailbox).build();
        with_device(device, async |_, handle, _| {
            let identity = handle.read_complete(0x1018, 0).await?;
            let elements = handle.read_complete(0x1018, 1).await?;
            assert_eq!((identity.len(), &identity[..2]), (18, &[4, 0][..]));
            assert_eq!(identity[2..], elements);
            let vendor = handle.read(obj::VENDOR_ID).await?;
            assert_eq!(elements[..4], vendor.to_le_bytes());

            let limits: Vec<u8> = [-5_000i32, 7_000]
                .iter()
                .flat_map(|limit| limit.to_le_bytes())
                .collect();
            handle.write_complete(0x607D, 1, limits.clone()).await?;
            assert_eq!(handle.read(obj::SOFTWARE_LIMIT_MIN).await?, -5_000);
            assert_eq!(handle.read(obj::SOFTWARE_LIMIT_MAX).await?, 7_000);
            let with_count = [&[2, 0][..], &limits].concat();
            assert_eq!(handle.read_complete(0x607D, 0).await?, with_count);

            // A list is written with its count: nothing, then one PDO.
            handle.write_complete(0x1C12, 0, vec![0, 0]).await?;
            assert_eq!(handle.read(obj::OUTPUT_ASSIGNMENT_COUNT).await?, 0);
            let one = vec![1, 0, 0x00, 0x16];
            handle.write_complete(0x1C12, 0, one.clone()).await?;
            assert_eq!(handle.read_complete(0x1C12, 0).await?, one);
            Ok::<_, DriveError>(())
        })
        .unwrap();
    }
}

#[test]
fn a_drive_without_complete_access_says_so() {
    with_drive(async |_, handle, _| {
        for result in [
            handle.read_complete(0x1018, 0).await.map(drop),
            handle.write_complete(0x607D, 1, vec![0; 8]).await,
        ] {
            let error = result.unwrap_err().error;
            assert_eq!(error.abort_code(), Some(AbortCode(0x0601_0004)), "{error}");
        }
        assert!(!matches!(
            handle
                .read(obj::VENDOR_ID)
                .await
                .map_err(|error| error.error),
            Err(SdoError::Timeout { .. })
        ));
    });
}
