"""Light separated into components at the first hit, with the motion vectors and gradients of the components.

The BSDF at the first hit is split exactly into its diffuse reflection lobe f_d and all other lobes f_o. L_e is the
light that a light source emits, L_r all other light that arrives, F = f_d cos θ L_e / p the contribution of a light
point of density p before any visibility test, and V its visibility, 0 or 1. One sample of each component is:

    emission     L_e of the first hit itself
    direct       the mean of F over 128 candidates, free of noise for practical purposes
    visibility   V of one candidate, chosen with a probability proportional to the luminance of F
    indirect     f_d cos θ L_r / q, along a direction that the whole BSDF samples with density q
    glossy       f_o cos θ (L_e + L_r) / q along the same direction, and a light point of its own; the balance
                 heuristic weighs the two ways to reach a light source
    color        emission + direct · visibility + glossy + indirect
"""
