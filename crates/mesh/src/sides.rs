//! Which sides of a finish take part in the exchange of light, and how.

use luxel_core::{Finish, GroupId, Rgb, Side};

/// What one side of a finish does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lit {
    /// Whether it reflects anything.
    pub reflects: bool,
    /// Whether it emits anything.
    pub emits: bool,
    /// Layer of its emission; `NONE` when it does not emit.
    pub group: GroupId,
}

/// Both sides, in the order in which `Front::patch_of` keeps them.
pub const SIDES: [Side; 2] = [Side::Front, Side::Back];

/// What `side` of `finish` does, or `None` if it neither reflects nor emits (no patch then).
///
/// Clear glass is no element on either side. An emitter of reflectance 0 is one.
pub fn lit_side(finish: &Finish, side: Side) -> Option<Lit> {
    if finish.transparent {
        return None;
    }
    let shines = |c: Rgb| c.max_band() > 0.0;
    let (reflects_here, emits_here) = match side {
        Side::Front => (true, true),
        Side::Back => (finish.back_reflects, finish.back_emits),
    };
    let reflects = reflects_here && shines(finish.reflectance);
    let emission = finish
        .emission
        .as_ref()
        .filter(|e| emits_here && shines(e.luminance));
    let group = emission.map_or(GroupId::NONE, |e| e.group);
    (reflects || emission.is_some()).then_some(Lit {
        reflects,
        emits: emission.is_some(),
        group,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_core::Emission;

    #[test]
    fn back_follows_its_own_rules() {
        let emission = Emission {
            luminance: Rgb::WHITE,
            texture: None,
            group: GroupId(2),
        };
        let mut finish = Finish {
            emission: Some(emission),
            ..Finish::default()
        };
        assert_eq!(
            lit_side(&finish, Side::Back),
            None,
            "single-sided: the back is black"
        );
        finish.back_reflects = true;
        let back = lit_side(&finish, Side::Back).expect("reflects");
        assert!(
            back.reflects && !back.emits && !back.group.is_some(),
            "OBJ: reflects, dark"
        );
        finish.reflectance = Rgb::BLACK;
        assert_eq!(lit_side(&finish, Side::Back), None);
        let front = lit_side(&finish, Side::Front).expect("a black emitter is an element");
        assert!(front.emits && !front.reflects && front.group == GroupId(2));
        finish.transparent = true;
        assert_eq!(
            lit_side(&finish, Side::Front),
            None,
            "clear glass is no element"
        );
    }
}
