//! Luxel's own scenes, written in code: the pictures of the README, the loads of the benches and
//! the enclosures of the property tests. For development only; no data of others is copied.
//!
//! Every scene is y up and in metres. Front sides see the room, room shells are closed where the
//! scene's text says so, no two faces lie in one another, and furniture stands on the floor with
//! its hidden faces left out. The same code gives the same bytes.

pub mod builder;
pub mod cornell;
pub mod corridor;
pub mod facets;
pub mod furnace;
pub mod furniture;
pub mod gallery;
pub mod office;
pub mod pictures;
pub mod two_rooms;
pub mod write_glb;

pub use builder::Builder;
pub use cornell::cornell;
pub use corridor::corridor;
pub use facets::{city_block, floating_boxes};
pub use furnace::{closed_box, furnace, l_shaped_furnace};
pub use gallery::gallery;
pub use office::office;
pub use two_rooms::two_rooms;
pub use write_glb::{to_glb, to_glb_with_mirrors};

/// The committed scenes: file name without `.glb`, and its bytes.
pub fn committed() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("two-rooms", to_glb(&two_rooms())),
        ("cornell", to_glb(&cornell())),
        ("office", to_glb(&office())),
        (
            "gallery",
            to_glb_with_mirrors(&gallery(), &[gallery::MIRROR]),
        ),
    ]
}
