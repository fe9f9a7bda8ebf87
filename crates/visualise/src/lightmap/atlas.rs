//! Rectangles of texels packed into pages.
//!
//! Shelves, tallest rectangles first, by the `etagere` library; the page is the smallest of a
//! series of squares that holds all. What does not fit on one of the largest pages goes on to the
//! next.

use etagere::{AtlasAllocator, size2};

/// Smallest edge of a page, and the factor from one to the next.
const SMALLEST: f64 = 64.0;
const GROWTH: f64 = 1.1;
/// Edges of pages are multiples of this, as block compression wants.
const MULTIPLE: u32 = 4;

/// Where a rectangle lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub page: u32,
    pub corner: [u32; 2],
}

/// Places of rectangles and the sizes of the pages; `None` when more than `most` pages with edges
/// of `largest` would be needed.
pub(crate) fn pack(
    sizes: &[[u32; 2]],
    largest: u32,
    most: usize,
) -> Option<(Vec<Place>, Vec<[u32; 2]>)> {
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&k| {
        (
            std::cmp::Reverse(sizes[k].map(|s| s)[1]),
            std::cmp::Reverse(sizes[k][0]),
            k,
        )
    });
    let whole: f64 = sizes.iter().map(|s| s[0] as f64 * s[1] as f64).sum();
    let mut places = vec![
        Place {
            page: 0,
            corner: [0, 0]
        };
        sizes.len()
    ];
    let mut pages = Vec::new();
    let mut left = order;
    while !left.is_empty() {
        if pages.len() == most {
            return None;
        }
        let mut edge = whole.sqrt().max(SMALLEST);
        let mut rest;
        let mut side;
        loop {
            side = (edge.ceil().min(largest as f64) as u32)
                .next_multiple_of(MULTIPLE)
                .min(largest);
            rest = fill(sizes, &left, side, pages.len() as u32, &mut places);
            if rest.is_empty() || side == largest {
                break;
            }
            edge *= GROWTH;
        }
        if rest.len() == left.len() {
            return None;
        }
        pages.push([side, side]);
        left = rest;
    }
    Some((places, pages))
}

/// Puts what fits on one page; answers with the rest.
fn fill(
    sizes: &[[u32; 2]],
    order: &[usize],
    side: u32,
    page: u32,
    places: &mut [Place],
) -> Vec<usize> {
    let mut allocator = AtlasAllocator::new(size2(side as i32, side as i32));
    let mut rest = Vec::new();
    for &k in order {
        let [w, h] = sizes[k];
        match allocator.allocate(size2(w as i32, h as i32)) {
            Some(a) => {
                let corner = [a.rectangle.min.x as u32, a.rectangle.min.y as u32];
                places[k] = Place { page, corner };
            }
            None => rest.push(k),
        }
    }
    rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_do_not_overlap_and_fill_most_of_the_page() {
        let sizes: Vec<[u32; 2]> = (0..500u32)
            .map(|k| [3 + k * 7919 % 40, 3 + k * 104_729 % 60])
            .collect();
        let (places, pages) = pack(&sizes, 4096, 1).expect("fits");
        let [w, h] = pages[0];
        let mut used = vec![false; (w * h) as usize];
        for (size, place) in sizes.iter().zip(&places) {
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let at = ((place.corner[1] + y) * w + place.corner[0] + x) as usize;
                    assert!(!used[at], "two rectangles at one texel");
                    used[at] = true;
                }
            }
        }
        let share = used.iter().filter(|&&u| u).count() as f64 / used.len() as f64;
        // Shelves of rectangles of all shapes waste about a third.
        assert!(share > 0.6, "{share} of the page is used");
    }

    #[test]
    fn what_does_not_fit_goes_to_the_next_page_or_is_refused() {
        let sizes = vec![[100, 100]; 9];
        let (places, pages) = pack(&sizes, 256, 3).expect("four on a page");
        assert_eq!(pages.len(), 3);
        assert_eq!(places.iter().filter(|p| p.page == 0).count(), 4);
        assert!(pack(&sizes, 256, 2).is_none());
        assert!(pack(&[[300, 10]], 256, 9).is_none(), "never fits");
        assert_eq!(pack(&[], 256, 1).expect("nothing to do").1.len(), 0);
    }
}
