//! Dialogues of SDO transfers. Bytes named AKD are from the public ethercrab repository,
//! dumps/soem-sdinfo-akd.pcapng; bytes named SOEM are requests that SOEM sent to a simulated drive.

use super::*;
use alloc::vec;
use alloc::vec::Vec;
use proptest::prelude::*;

const NAME: ObjectAddress = ObjectAddress::new(0x1008, 0);

fn object(index: u16, subindex: u8) -> ObjectAddress {
    ObjectAddress::new(index, subindex)
}

/// The bytes of a normal upload's first reply: size and what fits.
fn normal(object: ObjectAddress, size: u32, data: &[u8]) -> Vec<u8> {
    let mut reply = vec![0x41];
    reply.extend(object.index.to_le_bytes());
    reply.push(object.subindex);
    reply.extend(size.to_le_bytes());
    reply.extend(data);
    reply
}

/// A device that serves `data` in messages of `mailbox` bytes, written from the standard's tables.
fn serve_upload(object: ObjectAddress, data: &[u8], mailbox: usize) -> Result<Vec<u8>, SdoFault> {
    let mut upload = Upload::new(object);
    let first = data.len().min(mailbox - 16);
    let mut sent = first;
    let mut step = upload.feed(&normal(object, data.len() as u32, &data[..first]))?;
    let mut toggle = 0;
    while step == Step::More {
        assert_eq!(upload.request(), [0x60 | toggle << 4, 0, 0, 0, 0, 0, 0, 0]);
        let part = (data.len() - sent).min(mailbox - 9);
        let last = u8::from(sent + part == data.len());
        let unused = 7usize.saturating_sub(part);
        let mut reply = vec![toggle << 4 | (unused as u8) << 1 | last];
        reply.extend(&data[sent..sent + part]);
        reply.extend(vec![0; unused]);
        step = upload.feed(&reply)?;
        sent += part;
        toggle ^= 1;
    }
    assert_eq!(step, Step::Done);
    Ok(upload.into_data())
}

fn request_of(download: &Download) -> Vec<u8> {
    let mut request = Vec::new();
    download.append_request(&mut request);
    request
}

/// A device that takes a download apart again.
fn serve_download(object: ObjectAddress, data: Vec<u8>, mailbox: usize) -> Vec<u8> {
    let mut download = Download::new(object, data, mailbox);
    let [i0, i1] = object.index.to_le_bytes();
    let request = request_of(&download);
    assert!(request.len() + 8 <= mailbox);
    assert_eq!(request[1..4], [i0, i1, object.subindex]);
    let mut got = if request[0] & 2 != 0 {
        request[4..8 - usize::from(request[0] >> 2 & 3)].to_vec()
    } else {
        request[8..].to_vec()
    };
    let mut step = download
        .feed(&[0x60, i0, i1, object.subindex, 0, 0, 0, 0])
        .unwrap();
    let mut toggle = 0;
    while step == Step::More {
        let request = request_of(&download);
        assert!((8..=mailbox - 8).contains(&request.len()));
        assert_eq!(request[0] & 0xF0, toggle << 4);
        let unused = if request.len() == 8 {
            usize::from(request[0] >> 1 & 7)
        } else {
            0
        };
        got.extend(&request[1..request.len() - unused]);
        step = download
            .feed(&[0x20 | toggle << 4, 0, 0, 0, 0, 0, 0, 0])
            .unwrap();
        assert_eq!(step == Step::Done, request[0] & 1 == 1);
        toggle ^= 1;
    }
    got
}

#[test]
fn an_expedited_upload_of_a_real_akd_gives_its_bytes() {
    // 1C00h:3 = 3, 1C12h:1 = 1600h, 1600h:1 = 60400010h of a real AKD.
    for (address, reply, expected) in [
        (
            object(0x1C00, 3),
            [0x4F, 0x00, 0x1C, 3, 3, 0, 0, 0],
            &[3][..],
        ),
        (
            object(0x1C12, 1),
            [0x4B, 0x12, 0x1C, 1, 0, 0x16, 0, 0],
            &[0, 0x16],
        ),
        (
            object(0x1600, 1),
            [0x43, 0x00, 0x16, 1, 0x10, 0, 0x40, 0x60],
            &[0x10, 0, 0x40, 0x60],
        ),
    ] {
        let mut upload = Upload::new(address);
        assert_eq!(upload.request()[..4], [0x40, reply[1], reply[2], reply[3]]);
        assert_eq!(upload.feed(&reply), Ok(Step::Done));
        assert_eq!(upload.into_data(), expected);
    }
}

#[test]
fn a_normal_upload_in_one_mail_is_complete_at_once() {
    let mut upload = Upload::new(NAME);
    assert_eq!(
        upload.feed(&normal(NAME, 6, b"PP-SIM")),
        Ok(Step::Done),
        "a device name as a simulated drive sent it to SOEM"
    );
    assert_eq!(upload.into_data(), b"PP-SIM");
}

#[test]
fn an_expedited_reply_without_size_has_the_width_of_the_object() {
    let mut upload = Upload::new(object(0x6041, 0)).width(2);
    assert_eq!(
        upload.feed(&[0x42, 0x41, 0x60, 0, 0x37, 0x16, 0xEE, 0xEE]),
        Ok(Step::Done)
    );
    assert_eq!(upload.into_data(), [0x37, 0x16]);
}

#[test]
fn expedited_downloads_are_written_as_soem_writes_them() {
    // SOEM: 6081h = 200 000 as 23 81 60 00 40 0D 03 00.
    let download = Download::new(object(0x6081, 0), vec![0x40, 0x0D, 3, 0], 128);
    assert_eq!(
        request_of(&download),
        [0x23, 0x81, 0x60, 0, 0x40, 0x0D, 3, 0]
    );
    let one = Download::new(object(0x6060, 0), vec![1], 128);
    assert_eq!(request_of(&one), [0x2F, 0x60, 0x60, 0, 1, 0, 0, 0]);
    let two = Download::new(object(0x6068, 0), vec![10, 0], 128);
    assert_eq!(request_of(&two)[0], 0x2B);
    let three = Download::new(object(0x2000, 0), vec![1, 2, 3], 128);
    assert_eq!(request_of(&three)[0], 0x27);
}

#[test]
fn a_segmented_download_is_cut_as_soem_cuts_it() {
    // SOEM writes 300 bytes through a mailbox of 128: 21 … 2C 01 00 00 and 112 bytes, 00 and 119 bytes,
    // 11 and 69 bytes.
    let mut download = Download::new(object(0x2001, 0), vec![0x7A; 300], 128);
    let first = request_of(&download);
    assert_eq!(first[..8], [0x21, 0x01, 0x20, 0, 0x2C, 1, 0, 0]);
    assert_eq!(first.len(), 120);
    assert_eq!(
        download.feed(&[0x60, 0x01, 0x20, 0, 0, 0, 0, 0]),
        Ok(Step::More)
    );
    let second = request_of(&download);
    assert_eq!((second[0], second.len()), (0x00, 120));
    assert_eq!(download.feed(&[0x20, 0, 0, 0, 0, 0, 0, 0]), Ok(Step::More));
    let third = request_of(&download);
    assert_eq!((third[0], third.len()), (0x11, 70));
    assert_eq!(download.feed(&[0x30, 0, 0, 0, 0, 0, 0, 0]), Ok(Step::Done));
}

#[test]
fn downloads_at_the_boundaries_of_a_mailbox_have_the_stated_bytes() {
    // ETG.1000.6, download SDO segment request: bit 4 toggle, bits 1 to 3 unused bytes of seven, bit 0 last. Through a
    // mailbox of 128 go 112 bytes in the first message and 119 in each segment. Of each further message: command, length.
    for (length, mails) in [
        (111usize, &[][..]),
        (112, &[]),
        (113, &[(0x0Du8, 8usize)]),
        (118, &[(0x03, 8)]),
        (119, &[(0x01, 8)]),
        (120, &[(0x01, 9)]),
        (230, &[(0x01, 119)]),
        (231, &[(0x01, 120)]),
        (232, &[(0x00, 120), (0x1D, 8)]),
        (350, &[(0x00, 120), (0x11, 120)]),
        (351, &[(0x00, 120), (0x10, 120), (0x0D, 8)]),
    ] {
        let data: Vec<u8> = (0..length).map(|at| at as u8).collect();
        let mut download = Download::new(object(0x2001, 0), data.clone(), 128);
        let first = request_of(&download);
        let [l0, l1, l2, l3] = (length as u32).to_le_bytes();
        assert_eq!(first[..8], [0x21, 0x01, 0x20, 0, l0, l1, l2, l3]);
        assert_eq!(first[8..], data[..length.min(112)]);
        let mut step = download.feed(&[0x60, 0x01, 0x20, 0, 0, 0, 0, 0]).unwrap();
        let mut sent = first.len() - 8;
        for (at, (command, bytes)) in mails.iter().enumerate() {
            assert_eq!(step, Step::More);
            let segment = request_of(&download);
            assert_eq!((segment[0], segment.len()), (*command, *bytes), "{length}");
            let part = (length - sent).min(119);
            assert_eq!(segment[1..=part], data[sent..sent + part]);
            assert!(segment[part + 1..].iter().all(|byte| *byte == 0));
            sent += part;
            let confirmation = [0x20 | (at as u8 & 1) << 4, 0, 0, 0, 0, 0, 0, 0];
            step = download.feed(&confirmation).unwrap();
        }
        assert_eq!((step, sent), (Step::Done, length));
    }
}

#[test]
fn the_same_segments_are_understood_as_answers() {
    for (length, command, bytes) in [
        (113, 0x0D, 8),
        (118, 0x03, 8),
        (119, 0x01, 8),
        (120, 0x01, 9),
    ] {
        let data: Vec<u8> = (0..length).collect();
        let mut upload = Upload::new(NAME);
        let first = normal(NAME, u32::from(length), &data[..112]);
        assert_eq!(upload.feed(&first), Ok(Step::More));
        assert_eq!(upload.request(), [0x60, 0, 0, 0, 0, 0, 0, 0]);
        let mut segment = [&[command], &data[112..]].concat();
        segment.resize(bytes, 0);
        assert_eq!(upload.feed(&segment), Ok(Step::Done), "{length}");
        assert_eq!(upload.into_data(), data);
    }
}

#[test]
fn an_upload_whose_first_reply_has_no_data_comes_by_segments_alone() {
    // A simulated drive recorded with SOEM: 41 01 20 00 2C 01 00 00, then segments of 119, 119 and 62 bytes.
    let mut upload = Upload::new(object(0x2001, 0));
    assert_eq!(
        upload.feed(&[0x41, 0x01, 0x20, 0, 0x2C, 1, 0, 0]),
        Ok(Step::More)
    );
    let segment = |command: u8, length: usize| {
        let mut segment = vec![b'z'; length + 1];
        segment[0] = command;
        segment
    };
    assert_eq!(upload.feed(&segment(0x00, 119)), Ok(Step::More));
    assert_eq!(upload.feed(&segment(0x10, 119)), Ok(Step::More));
    assert_eq!(upload.feed(&segment(0x01, 62)), Ok(Step::Done));
    assert_eq!(upload.into_data().len(), 300);
}

#[test]
fn the_shortest_segment_tells_how_many_bytes_it_has() {
    // The last segment of 600 bytes recorded with SOEM: 15 "56789" 0 0, five of seven bytes used.
    let mut upload = Upload::new(object(0x2000, 0));
    assert_eq!(
        upload.feed(&normal(object(0x2000, 0), 12, b"")),
        Ok(Step::More)
    );
    assert_eq!(upload.feed(b"\x000123456"), Ok(Step::More));
    assert_eq!(upload.feed(b"\x1556789\0\0"), Ok(Step::Done));
    assert_eq!(upload.into_data(), b"012345656789");
}

#[test]
fn transfers_at_every_boundary_arrive_whole() {
    for mailbox in [16, 17, 23, 24, 64] {
        for length in 0..80 {
            let data: Vec<u8> = (0..length).collect();
            assert_eq!(
                serve_upload(NAME, &data, mailbox),
                Ok(data.clone()),
                "upload of {length} bytes, mailbox {mailbox}"
            );
            assert_eq!(
                serve_download(NAME, data.clone(), mailbox),
                data,
                "download of {length} bytes, mailbox {mailbox}"
            );
        }
    }
}

#[test]
fn complete_access_sets_its_bit() {
    let entry = object(0x1C12, 1);
    assert_eq!(Upload::new(entry).complete_access().request()[0], 0x50);
    let download = Download::new(entry, vec![0; 8], 128).complete_access();
    assert_eq!(request_of(&download)[0], 0x31);
}

#[test]
fn an_abort_ends_the_transfer_with_its_code() {
    // A simulated drive recorded with SOEM: 5555h does not exist.
    let reply = [0x80, 0x55, 0x55, 0, 0, 0, 2, 6];
    let mut upload = Upload::new(object(0x5555, 0));
    assert_eq!(
        upload.feed(&reply),
        Err(SdoFault::Aborted(AbortCode::NO_OBJECT))
    );
    let mut download = Download::new(object(0x5555, 0), vec![1], 128);
    assert_eq!(
        download.feed(&reply),
        Err(SdoFault::Aborted(AbortCode::NO_OBJECT))
    );
}

#[test]
fn an_abort_with_request_flags_left_in_it_is_still_an_abort() {
    let mut upload = Upload::new(object(0x1018, 9)).complete_access();
    assert_eq!(
        upload.feed(&[0x90, 0x18, 0x10, 9, 0x11, 0, 9, 6]),
        Err(SdoFault::Aborted(AbortCode::NO_SUBINDEX))
    );
}

#[test]
fn replies_of_other_requests_are_foreign() {
    let mut upload = Upload::new(object(0x6041, 0));
    for late in [
        [0x4B, 0x40, 0x60, 0, 6, 0, 0, 0],
        [0x4B, 0x41, 0x60, 1, 6, 0, 0, 0],
        [0x60, 0x41, 0x60, 0, 0, 0, 0, 0],
        [0x80, 0x40, 0x60, 0, 0, 0, 2, 6],
        [0x01, 1, 2, 3, 4, 5, 6, 7],
        [0x20, 0, 0, 0, 0, 0, 0, 0],
    ] {
        assert_eq!(upload.feed(&late), Ok(Step::Foreign), "{late:02X?}");
    }
    assert_eq!(
        upload.feed(&[0x4B, 0x41, 0x60, 0, 0x37, 2, 0, 0]),
        Ok(Step::Done),
        "the transfer is unharmed"
    );
    let mut download = Download::new(object(0x6060, 0), vec![1], 128);
    for late in [
        [0x4F, 0x60, 0x60, 0, 1, 0, 0, 0],
        [0x60, 0x81, 0x60, 0, 0, 0, 0, 0],
    ] {
        assert_eq!(download.feed(&late), Ok(Step::Foreign), "{late:02X?}");
    }
}

#[test]
fn a_wrong_toggle_bit_is_an_error_in_both_directions() {
    let mut upload = Upload::new(NAME);
    assert_eq!(upload.feed(&normal(NAME, 20, b"")), Ok(Step::More));
    let wrong = SdoFault::Toggle {
        expected: 0,
        got: 1,
    };
    assert_eq!(upload.feed(b"\x100123456"), Err(wrong));
    assert_eq!(wrong.abort_code(), Some(AbortCode::TOGGLE));

    let mut download = Download::new(NAME, vec![0; 20], 16);
    assert_eq!(
        download.feed(&[0x60, 0x08, 0x10, 0, 0, 0, 0, 0]),
        Ok(Step::More)
    );
    assert_eq!(download.feed(&[0x20, 0, 0, 0, 0, 0, 0, 0]), Ok(Step::More));
    assert_eq!(
        download.feed(&[0x20, 0, 0, 0, 0, 0, 0, 0]),
        Err(SdoFault::Toggle {
            expected: 1,
            got: 0
        })
    );
}

#[test]
fn lengths_that_are_not_as_announced_are_errors() {
    let mut short = Upload::new(NAME);
    assert_eq!(short.feed(&normal(NAME, 20, b"")), Ok(Step::More));
    assert_eq!(
        short.feed(b"\x010123456"),
        Err(SdoFault::Size {
            expected: 20,
            got: 7
        })
    );
    let mut long = Upload::new(NAME);
    assert_eq!(long.feed(&normal(NAME, 5, b"")), Ok(Step::More));
    assert_eq!(
        long.feed(b"\x000123456"),
        Err(SdoFault::Size {
            expected: 5,
            got: 7
        })
    );
    let mut endless = Upload::new(NAME);
    assert!(matches!(
        endless.feed(&normal(NAME, u32::MAX, b"")),
        Err(SdoFault::Size { .. })
    ));
}

#[test]
fn empty_segments_without_end_are_refused() {
    let mut upload = Upload::new(NAME);
    assert_eq!(upload.feed(&normal(NAME, 5, b"")), Ok(Step::More));
    assert!(matches!(
        upload.feed(&[0x0E, 0, 0, 0, 0, 0, 0, 0]),
        Err(SdoFault::Unexpected { got: 0x0E, .. })
    ));
}

#[test]
fn every_truncation_of_every_reply_is_an_error() {
    for whole in [
        [0x4B, 0x41, 0x60, 0, 0x37, 2, 0, 0],
        [0x80, 0x41, 0x60, 0, 0, 0, 2, 6],
        [0x60, 0x41, 0x60, 0, 0, 0, 0, 0],
        [0x20, 0, 0, 0, 0, 0, 0, 0],
        [0x01, 1, 2, 3, 4, 5, 6, 7],
    ] {
        for got in 0..whole.len() {
            let cut = Err(SdoFault::Cut(CutMail { needed: 8, got }));
            assert_eq!(Upload::new(object(0x6041, 0)).feed(&whole[..got]), cut);
            assert_eq!(
                Download::new(object(0x6041, 0), vec![1], 64).feed(&whole[..got]),
                cut
            );
        }
    }
}

#[test]
fn the_masters_abort_names_the_object() {
    assert_eq!(
        abort_request(object(0x2001, 3), AbortCode::TIME_OUT),
        [0x80, 0x01, 0x20, 3, 0, 0, 4, 5]
    );
}

proptest! {
    #[test]
    fn any_data_survives_any_mailbox(data in prop::collection::vec(any::<u8>(), 0..600), mailbox in 16usize..200) {
        prop_assert_eq!(serve_upload(NAME, &data, mailbox), Ok(data.clone()));
        prop_assert_eq!(serve_download(NAME, data.clone(), mailbox), data);
    }

    #[test]
    fn no_replies_make_a_transfer_panic(replies in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..20)) {
        let mut upload = Upload::new(NAME);
        let _ = upload.feed(&normal(NAME, 100, b""));
        let mut download = Download::new(NAME, vec![7; 100], 20);
        let _ = download.feed(&[0x60, 0x08, 0x10, 0, 0, 0, 0, 0]);
        for reply in replies {
            let _ = (upload.feed(&reply), download.feed(&reply));
            prop_assert!(upload.clone().into_data().len() <= 100);
            prop_assert!(!request_of(&download).is_empty());
        }
    }
}
