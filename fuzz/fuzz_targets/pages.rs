//! Any bytes as a page of a table, a page list or a tree node: an error or a page that is written as it was read.
//! The first byte chooses the kind; the address asked for is the one that the bytes claim.
#![no_main]

use libfuzzer_sys::fuzz_target;
use terraquilt::base::bytes::Reader;
use terraquilt::store::quadtree::Node;
use terraquilt::store::table::{PageAddress, PatchPage, TopPage, find, put_list, read_list};

fuzz_target!(|data: &[u8]| {
    let Some((kind, bytes)) = data.split_first() else { return };
    match kind % 4 {
        0 => {
            let at = address(bytes);
            let Ok(page) = PatchPage::decode(bytes, at, "fuzz") else { return };
            (0..256).for_each(|slot| {
                page.block(slot);
            });
            let written = page.encode(at);
            let again = PatchPage::decode(&written, at, "fuzz").expect("what was written is read");
            assert_eq!(again.encode(at), written);
            assert_eq!(again.is_empty(), page.is_empty());
        }
        1 => {
            let at = address(bytes);
            let Ok(page) = TopPage::decode(bytes, at, "fuzz") else { return };
            (0..256).for_each(|slot| {
                page.block(slot);
            });
            let written = page.encode(at);
            let again = TopPage::decode(&written, at, "fuzz").expect("what was written is read");
            assert_eq!(again.encode(at), written);
        }
        2 => {
            let mut reader = Reader::new(bytes, "fuzz", "list");
            let Ok(list) = read_list(&mut reader) else { return };
            assert!(list.iter().all(|(at, page)| find(&list, *at) == Some(*page)));
            let mut written = Vec::new();
            put_list(&mut written, &list);
            assert_eq!(written, bytes[..bytes.len() - reader.remaining()]);
        }
        _ => {
            let Ok(node) = Node::decode(bytes, "fuzz") else { return };
            let _ = node.aggregates();
            let written = node.encode();
            assert_eq!(written.len(), bytes.len());
            let again = Node::decode(&written, "fuzz").expect("what was written is read");
            assert_eq!(again.encode(), written);
        }
    }
});

fn address(bytes: &[u8]) -> PageAddress {
    let mut claimed = [0u8; 10];
    let n = bytes.len().min(10);
    claimed[..n].copy_from_slice(&bytes[..n]);
    let int = |k: usize| i32::from_le_bytes(claimed[k..k + 4].try_into().expect("four bytes"));
    PageAddress { level: claimed[1], i: int(2), j: int(6) }
}
